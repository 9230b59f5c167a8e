"""The reference filters: against the compiled kernel, against each other, and against closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

from submaps.config import MotionConfig, ObservationConfig
from submaps.filtering import unscented
from submaps.filtering.unscented import Scaling
from submaps.geometry.space import PLANE, SOLID, Space
from submaps.reference import ekf, moment_filter
from submaps.reference.compiled import Compiled, KernelFilter
from submaps.reference.ekf import Estimate
from submaps.reference.flatland import process
from submaps.reference.linear import Beads, Record, closed_form, filtered, in_order
from submaps.reference.moments import Exact, Rule, SeenRangeBearing, ShownRangeBearing, first_order, second_order
from submaps.reference.motion import increment
from submaps.reference.observation import Point, Sighting, inverted
from submaps.reference.retraction import RETRACTIONS, Retraction, Standard, after
from submaps.reference.space import LINE, Geometry, turned
from tests.core.filters import SENSORS
from tests.core.support import random_covariance
from tests.core.test_jacobians import POINTS

Floats = NDArray[np.float64]
errors = pytest.mark.parametrize("error", RETRACTIONS)
sensors = pytest.mark.parametrize("sensor", SENSORS.values(), ids=SENSORS)
spaces = pytest.mark.parametrize("space", [PLANE, SOLID], ids=lambda space: space.name)
RANGE_BEARING = Compiled(ObservationConfig("range_bearing", (0.1, 0.02)))


def retraction_of(error: str, space: Geometry = PLANE) -> Retraction:
    return cast(Retraction, RETRACTIONS[error](space))


def generic(space: Space, landmarks: int, seed: int) -> Estimate:
    """A state whose landmarks are some metres off, with a full covariance."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=space.pose + space.dim * landmarks)
    offsets = rng.normal(size=(landmarks, space.dim))
    offsets *= 8.0 / np.linalg.norm(offsets, axis=1)[:, np.newaxis]
    x[space.pose :] = (x[: space.dim] + offsets).ravel()
    return Estimate(x, random_covariance(rng, x.shape[0], 0.1))


def sightings(space: Space, estimate: Estimate, count: int, seed: int) -> list[Sighting]:
    """Readings near what each of the first landmarks would give."""
    rng = np.random.default_rng(seed)
    out = []
    for i in range(count):
        slot = space.pose + i * space.dim
        pose = space.as_pose(estimate.x)
        y = space.transform(space.inverse(pose), estimate.x[slot : slot + space.dim])
        out.append(
            Sighting(slot, y + 0.1 * rng.normal(size=space.dim), random_covariance(rng, space.dim, 0.1), Point())
        )
    return out


def assert_equal(found: Estimate, expected: Estimate, tolerance: float = 1e-10) -> None:
    """Equal to so many standard deviations."""
    difference, sigma = found.x - expected.x, np.sqrt(np.diag(expected.P))
    difference[2] = math.remainder(difference[2], 2.0 * math.pi)
    assert np.abs(difference / sigma).max() < tolerance
    assert np.max(np.abs(found.P - expected.P) / np.outer(sigma, sigma)) < tolerance


@errors
@sensors
@pytest.mark.parametrize("seed", range(3))
def test_the_compiled_kernel_is_the_reference(error: str, sensor: ObservationConfig, seed: int) -> None:
    """From a random state with an initial uncertainty: move, see what is known, see what is new, again."""
    model, rng = Compiled(sensor), np.random.default_rng(seed)
    space, retraction = model.space, retraction_of(error, model.space)
    known = POINTS[space.name]
    estimate = generic(space, 0, 40 + seed)
    estimate = Estimate(estimate.x, random_covariance(rng, space.pose, 0.02))
    kernel = KernelFilter(estimate, model, invariant=error == "invariant", landmarks=8)
    for k in range(4):
        if k:
            step, noise = rng.normal(size=space.pose) * 0.1, random_covariance(rng, space.pose, 0.01)
            estimate = ekf.predict(retraction, estimate, step, noise)
            kernel.predict(step, noise)
            assert_equal(kernel.estimate, estimate, 1e-8)
        for slot in range(space.pose, estimate.x.shape[0], space.dim):
            point = estimate.x[slot : slot + space.dim]
            y = space.transform(space.inverse(space.as_pose(estimate.x)), point)
            z = model.predict(y)[0] + rng.normal(size=len(sensor.channels)) * sensor.sigma
            if np.isfinite(z).all():
                estimate = ekf.update(retraction, estimate, [Sighting(slot, z, model.R, model)])
                assert kernel.update(np.array([slot]), z[np.newaxis], model.R) == 1
                assert_equal(kernel.estimate, estimate, 1e-8)
        z = model.predict(np.array(known[k % len(known)]))[0]
        assert kernel.augment(z, model.R) == estimate.x.shape[0]
        estimate = ekf.augment(retraction, estimate, z, model.R, model)
        assert_equal(kernel.estimate, estimate, 1e-8)


@errors
@spaces
def test_the_three_forms_of_an_update_agree(space: Space, error: str) -> None:
    """P - W S W^T, (I - W H) P, and landmark by landmark where nothing is left to linearise anew."""
    retraction, estimate = retraction_of(error, space), generic(space, 5, 1)
    seen = sightings(space, estimate, 4, 2)
    joint = ekf.update(retraction, estimate, seen)
    assert_equal(ekf.update(retraction, estimate, seen, ekf.naive), joint)
    assert np.trace(joint.P) < np.trace(estimate.P)
    # The same linearisation for each reading: the covariance does not depend on the order, nor on the grouping.
    v, H, R = ekf.linearised(retraction, estimate.x, seen)
    xi, P, d = np.zeros(estimate.x.shape[0]), estimate.P, space.dim
    for i in range(len(seen)):
        rows = slice(d * i, d * i + d)
        S = H[rows] @ P @ H[rows].T + R[rows, rows]
        W = np.asarray(np.linalg.solve(S, H[rows] @ P).T, dtype=np.float64)
        xi, P = xi + W @ (v[rows] - H[rows] @ xi), ekf.subtracted(P, H[rows], S, W)
    assert_equal(Estimate(retraction.plus(estimate.x, xi), P), joint)


def by_ekf(record: Record, error: str, *, each: bool = False) -> tuple[Floats, Floats]:
    """Position and landmarks in the closed form's order, by an EKF."""
    *_, (estimate, slots) = filtered(record, retraction_of(error, record.space), each=each)
    rows = in_order(record.space, slots)
    return estimate.x[rows], estimate.P[np.ix_(rows, rows)]


def by_ukf(record: Record) -> tuple[Floats, Floats]:
    """The same by the UKF on (position, landmarks); the rotations, being known, are no part of the state."""
    space, d, scaling = record.space, record.space.dim, Scaling()
    x, P, theta, order = record.start[:d], record.P0, record.start[d:], list[int]()
    for k, seen in enumerate(record.seen):
        if k:
            step, noise = np.zeros_like(x), np.zeros_like(P)
            R = space.rotation_of(theta)
            step[:d], noise[:d, :d] = R @ record.increments[k - 1][:d], R @ record.Q @ R.T
            moved = unscented.predict(x, P, partial(np.add, step), noise, np.add, np.subtract, scaling)
            x, P, theta = moved.state, moved.covariance, turned(space, theta, record.increments[k - 1][d:])
        R = space.rotation_of(theta)
        for i, z in sorted(seen, key=lambda one: one[0] not in order):
            if i in order:
                at = d + d * order.index(i)

                def observe(states: Floats, at: int = at, R: Floats = R) -> Floats:
                    return np.asarray((states[..., at : at + d] - states[..., :d]) @ R)

                updated = unscented.update(x, P, z, observe, record.R, np.add, scaling)
                x, P = updated.state, updated.covariance
            else:
                noise = np.zeros((len(x) + d,) * 2)
                noise[-d:, -d:] = R @ record.R @ R.T

                def shown(states: Floats, at: Floats = R @ z) -> Floats:
                    return np.concatenate([states, states[..., :d] + at], axis=-1)

                grown = unscented.predict(x, P, shown, noise, np.add, np.subtract, scaling)
                x, P = grown.state, grown.covariance
                order.append(i)
    rows = np.array([*range(d), *(d + d * order.index(i) + a for i in sorted(order) for a in range(d))])
    return x[rows], P[np.ix_(rows, rows)]


# A filter that this package gains is one more row.
FILTERS: dict[str, Callable[[Record], tuple[Floats, Floats]]] = {
    "EKF": partial(by_ekf, error="standard"),
    "EKF, landmark by landmark": partial(by_ekf, error="standard", each=True),
    "invariant EKF": partial(by_ekf, error="invariant"),
    "invariant EKF, landmark by landmark": partial(by_ekf, error="invariant", each=True),
    "UKF": by_ukf,
}


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("space", [LINE, PLANE, SOLID], ids=["line", "plane", "space"])
def test_a_linear_world_has_one_answer(space: Geometry, name: str) -> None:
    """With known rotations every filter is the closed form, joint or landmark by landmark."""
    record = linear_drive(space, 6)
    mean, covariance = closed_form(record, 6)
    x, P = FILTERS[name](record)
    assert np.abs(x - mean).max() < 1e-10
    assert np.abs(P - covariance).max() < 1e-10


def linear_drive(space: Geometry, landmarks: int) -> Record:
    """A robot that turns, for certain, as it goes, from an uncertain place."""
    rng, d = np.random.default_rng(8), space.dim
    points = rng.normal(size=(landmarks, d)) * 4.0
    pose: tuple[float, ...] = (0.0,) * space.pose
    increments, seen = [], []
    for k in range(30):
        if k:
            step = np.concatenate([rng.normal(size=d), 0.6 * rng.normal(size=space.rot)])
            pose = space.compose(pose, tuple(step.tolist()))
            increments.append(step + np.concatenate([0.1 * rng.normal(size=d), np.zeros(space.rot)]))
        R, p = space.rotation_of(np.array(pose[d:])), np.array(pose[:d])
        near = rng.permutation(landmarks)[:3] if k else np.arange(landmarks)
        seen.append(tuple((int(i), R.T @ (points[i] - p) + 0.2 * rng.normal(size=d)) for i in near))
    Q, R0, P0 = (random_covariance(rng, d, scale) for scale in (0.1, 0.2, 0.7))
    return Record(space, np.array(increments), tuple(seen), Q, R0, np.zeros(space.pose), P0)


@pytest.mark.parametrize("move_sigma", [0.0, 0.1])
def test_beads_become_a_rigid_map_as_uncertain_as_the_vehicle_was(move_sigma: float) -> None:
    beads = Beads(np.arange(6.0), (0.0, 5.0), 1.0, 1.6, 0.5, move_sigma, 0.2)
    record, _ = beads.drive(3000, np.random.default_rng(2))
    relative, absolute = [], []
    for estimate, slots in filtered(record, Standard(LINE)):
        if len(slots) == 6:
            rows = in_order(LINE, slots)[1:]
            P = estimate.P[np.ix_(rows, rows)]
            own = np.diag(P)
            relative.append(own[:, np.newaxis] + own - 2.0 * P)
            absolute.append(own)
    assert np.all(np.diff(relative, axis=0) <= 1e-12)
    assert np.max(relative[-1]) < 0.01 * np.max(relative[0])
    assert np.all(np.diff(absolute, axis=0) <= 1e-12)
    assert absolute[-1] == pytest.approx(beads.limit, rel=1e-3)
    assert np.all(absolute[-1] > beads.limit)
    if not move_sigma:
        assert beads.limit == 0.25


@errors
def test_the_initial_uncertainty_of_the_vehicle(error: str) -> None:
    """Given of the additive errors, kept in the filter's own, and given back as it came."""
    for space in (PLANE, SOLID):
        retraction = retraction_of(error, space)
        pose = generic(space, 0, 5).x
        P0 = random_covariance(np.random.default_rng(6), space.pose, 0.2)
        assert_equal(
            Estimate(pose, ekf.additive_covariance(retraction, ekf.start(retraction, pose, P0))), Estimate(pose, P0)
        )


def test_the_prediction_is_that_of_the_lecture() -> None:
    """grad f_x P grad f_x^T + grad f_v Q grad f_v^T, the landmarks' own block as it was."""
    estimate = generic(PLANE, 3, 9)
    config = MotionConfig("bicycle", (0.3, 0.05), wheelbase=1.5)
    found = ekf.predict(Standard(), estimate, *increment(config, (2.0, 0.3), 0.4))
    pose, by_pose, by_noise = process(estimate.x[:3], np.array([2.0, 0.3]), 1.5, 0.4)
    F, B = np.eye(9), np.zeros((9, 2))
    F[:3, :3], B[:3] = by_pose, by_noise
    expected = F @ estimate.P @ F.T + B @ np.diag([0.09, 0.0025]) @ B.T
    assert_equal(found, Estimate(np.concatenate([pose, estimate.x[3:]]), expected))
    assert np.array_equal(found.P[3:, 3:], estimate.P[3:, 3:])


@errors
def test_an_inverted_reading_updates_as_the_reading_does(error: str) -> None:
    """To first order: the closer the reading is to what was expected, the less it matters where one linearises."""
    retraction, estimate, model = retraction_of(error), generic(PLANE, 2, 10), RANGE_BEARING
    y = PLANE.transform(PLANE.inverse(PLANE.as_pose(estimate.x)), estimate.x[3:5])
    apart = []
    for size in (1e-2, 1e-3):
        z = model.predict(y)[0] + size * np.array([1.0, 0.3])
        sighting = Sighting(3, z, np.diag([0.01, 1e-4]), model)
        a, b = (ekf.update(retraction, estimate, [s]) for s in (sighting, inverted(sighting)))
        apart.append((np.abs(a.x - b.x).max(), np.abs(a.P - b.P).max()))
        assert np.abs(a.x - estimate.x).max() > 1e-2 * size
    (x0, P0), (x1, P1) = apart
    assert x1 < 0.02 * x0  # second order in the size
    assert P1 < 0.2 * P0  # first


def test_exact_moments_are_those_of_the_closed_form() -> None:
    """E[r cos a] with r, a independent normal: r^ cos(a^) exp(-s²/2), and its square alike."""
    psi, r, beta, P = 0.3, 5.0, 0.9, np.diag([0.3**2, 0.1**2, 0.2**2])
    value, covariance, cross = Exact(15)(ShownRangeBearing(), np.array([psi, r, beta]), P)
    angle, s2 = psi + beta, 0.3**2 + 0.2**2
    fall = math.exp(-0.5 * s2)
    assert value == pytest.approx(fall * r * np.array([math.cos(angle), math.sin(angle)]), rel=1e-12)
    squared = 0.5 * (r * r + 0.01) * (1.0 + math.exp(-2.0 * s2) * math.cos(2.0 * angle))
    assert covariance[0, 0] == pytest.approx(squared - value[0] ** 2, rel=1e-10)
    assert cross[0] == pytest.approx(0.09 * fall * r * np.array([-math.sin(angle), math.cos(angle)]), rel=1e-11)


class Quadratic:
    """q^T A_i q + b_i^T q: what moments of second order are exact for."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.A = np.stack([random_covariance(rng, 3), -random_covariance(rng, 3)])
        self.b = rng.normal(size=(2, 3))

    def __call__(self, q: Floats) -> Floats:
        return np.asarray(np.einsum("ka,iab,kb->ki", q, self.A, q) + q @ self.b.T)

    def jacobian(self, q: Floats) -> Floats:
        return 2.0 * self.A @ q + self.b

    def hessians(self, q: Floats) -> Floats:
        return 2.0 * self.A


def test_moments_of_second_order_are_exact_for_a_quadratic() -> None:
    rng = np.random.default_rng(11)
    f, mean, P = Quadratic(rng), rng.normal(size=3), random_covariance(rng, 3)
    for found, expected in zip(second_order(f, mean, P), Exact(3)(f, mean, P), strict=True):
        assert np.allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize("f", [SeenRangeBearing(), ShownRangeBearing()], ids=["seen", "shown"])
def test_means_of_second_order_leave_the_fourth_power_of_the_spread(f: SeenRangeBearing | ShownRangeBearing) -> None:
    mean = np.array([4.0, -3.0, 0.4]) if isinstance(f, SeenRangeBearing) else np.array([0.4, 7.0, 1.9])
    P = random_covariance(np.random.default_rng(11), 3, 0.3)
    for rule, power in ((first_order, 2), (second_order, 4)):
        near, far = (
            np.abs(rule(f, mean, P * scale**2)[0] - Exact()(f, mean, P * scale**2)[0]).max() for scale in (0.2, 0.4)
        )
        assert far / near == pytest.approx(2.0**power, rel=0.1)


def moment_run(rule: Rule) -> Estimate:
    """A pose that is uncertain, a landmark, and readings of it."""
    rng, R = np.random.default_rng(12), np.diag([0.01, 4e-4])
    estimate = Estimate(np.array([1.0, 2.0, 0.3]), random_covariance(rng, 3, 0.1))
    z = np.array([5.0, 0.9])
    estimate = moment_filter.augment(estimate, z, R, rule)
    for _ in range(4):
        estimate = moment_filter.update(estimate, 3, z + rng.normal(size=2) * (0.1, 0.02), R, rule)
    return estimate


def test_a_moment_filter_with_linear_moments_is_the_ekf() -> None:
    rng, R, model = np.random.default_rng(12), np.diag([0.01, 4e-4]), RANGE_BEARING
    expected = Estimate(np.array([1.0, 2.0, 0.3]), random_covariance(rng, 3, 0.1))
    z = np.array([5.0, 0.9])
    expected = ekf.augment(Standard(), expected, z, R, model)
    for _ in range(4):
        reading = z + rng.normal(size=2) * (0.1, 0.02)
        expected = ekf.update(Standard(), expected, [Sighting(3, reading, R, model)])
    assert_equal(moment_run(first_order), expected)
    assert_equal(moment_run(Exact(9)), moment_run(Exact(13)), 1e-9)


def test_motion_in_any_space_is_composition() -> None:
    for space in (PLANE, SOLID):
        x, step = generic(space, 2, 13).x, generic(space, 0, 14).x
        assert after(space, x, step)[: space.pose] == pytest.approx(
            space.compose(space.as_pose(x), space.as_pose(step))
        )
