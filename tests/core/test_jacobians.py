"""Every derivative of a model against central differences, under both errors: one row a model.

A row of ``MOTIONS``, or of ``filters.SENSORS``, is all that a new model needs here.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

from submaps.config import MotionConfig, ObservationConfig
from submaps.geometry.space import PLANE, SOLID, SPACES, Space
from submaps.reference import ekf
from submaps.reference.compiled import Compiled
from submaps.reference.ekf import Estimate
from submaps.reference.flatland import process
from submaps.reference.moments import SeenRangeBearing, ShownRangeBearing
from submaps.reference.motion import increment
from submaps.reference.observation import Sighting, inverted
from submaps.reference.retraction import RETRACTIONS, Retraction, after
from tests.core.filters import SENSORS
from tests.core.support import jacobian, random_covariance

Floats = NDArray[np.float64]
WORST = 1e-6  # relative
DT = 0.7


@dataclass(frozen=True)
class Motion:
    """A row: a motion model and a control that bends."""

    name: str
    config: MotionConfig
    control: tuple[float, ...]


MOTIONS = [
    Motion("odometry", MotionConfig("odometry", (0.1, 0.1, 0.1)), (1.0, -0.3, 0.4)),
    Motion("velocity", MotionConfig("velocity", (0.1, 0.1)), (1.3, 0.6)),
    Motion("velocity, straight", MotionConfig("velocity", (0.1, 0.1)), (1.3, 0.0)),
    Motion("bicycle", MotionConfig("bicycle", (0.1, 0.1), wheelbase=1.5), (2.0, 0.3)),
    Motion("ackermann", MotionConfig("ackermann", (0.1, 0.1), wheelbase=2.8, encoder_offset=0.7), (2.0, -0.4)),
    Motion("odometry3d", MotionConfig("odometry3d", (0.1,) * 6), (1.0, -0.3, 0.2, 0.3, -0.5, 0.2)),
]  # fmt: skip
# Points (body frame, m) that the sensors of ``filters.SENSORS`` have in view.
POINTS = {
    "se2": ((10.0, 4.0), (-7.0, 2.0), (3.0, -9.0), (-8.0, -8.0)),
    "se3": ((10.0, 4.0, 1.0), (7.0, -2.0, 3.0), (23.0, 9.0, -6.0)),
}

motions = pytest.mark.parametrize("row", MOTIONS, ids=lambda row: row.name)
sensors = pytest.mark.parametrize("sensor", SENSORS.values(), ids=SENSORS)
errors = pytest.mark.parametrize("error", RETRACTIONS)


def retraction_of(error: str, space: Space) -> Retraction:
    return cast(Retraction, RETRACTIONS[error](space))


def state(space: Space, landmarks: int, seed: int) -> Floats:
    """A pose well away from the origin, and landmarks about it."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(landmarks, space.dim)) * 6.0
    return np.concatenate([rng.normal(size=space.dim) * 4.0, 0.8 * rng.normal(size=space.rot), points.ravel()])


def assert_close(found: Floats, expected: Floats) -> None:
    assert np.abs(found - expected).max() <= WORST * np.abs(expected).max()


@errors
@motions
def test_motion(row: Motion, error: str) -> None:
    """F, and G A Q A^T G^T for control noise Q along each pair of channels (A = d increment / d control)."""
    space = SPACES[row.config.space]
    retraction, x = retraction_of(error, space), state(space, 3, 1)
    n, channels = x.shape[0], len(row.control)
    moved = after(space, x, increment(row.config, row.control, DT)[0])

    def end(both: Floats) -> Floats:
        true = retraction.plus(x, both[:n])
        done, _ = increment(row.config, (row.control + both[n:]).tolist(), DT)
        return retraction.minus(after(space, true, done), moved)

    J = jacobian(end, np.zeros(n + channels))
    F, G = retraction.moved(x, moved)
    whole = np.eye(n)
    whole[: space.pose, : space.pose] = F
    assert_close(whole, J[:, :n])
    for i, j in itertools.combinations_with_replacement(range(channels), 2):
        Q = np.zeros((channels, channels))
        Q[i, j] = Q[j, i] = 1.0
        Q += 2.0 * np.eye(channels)
        _, noise = increment(row.config, row.control, DT, Q)
        found = np.zeros((n, n))
        found[: len(G), : len(G)] = G @ noise @ G.T
        assert_close(found, J[:, n:] @ Q @ J[:, n:].T)


@errors
@sensors
def test_observation(sensor: ObservationConfig, error: str) -> None:
    """H = dh/dy [dy/dpose, ..., dy/dl, ...]."""
    model = Compiled(sensor)
    space, retraction = model.space, retraction_of(error, model.space)
    for k, y in enumerate(POINTS[space.name]):
        x = state(space, 3, 2 + k)
        slot = space.pose + space.dim
        x[slot : slot + space.dim] = space.transform(space.as_pose(x), np.array(y))
        z = model.predict(np.array(y))[0]

        def reading(xi: Floats, x: Floats = x, z: Floats = z, slot: int = slot) -> Floats:
            moved = retraction.plus(x, xi)
            point = space.transform(space.inverse(space.as_pose(moved)), moved[slot : slot + space.dim])
            return model.innovation(model.predict(point)[0], z)

        v, H, _ = ekf.linearised(retraction, x, [Sighting(slot, z, model.R, model)])
        assert np.abs(v).max() < 1e-9 * np.abs(z).max()
        assert_close(H, jacobian(reading, np.zeros(x.shape[0]), 1e-3))


def shown(sensor: ObservationConfig, z: Floats) -> Floats:
    """The body-frame point of a reading, and, where it leaves the depth open, of a depth as its last number."""
    if sensor.depth is not None:
        sensor = replace(sensor, depth=replace(sensor.depth, mean=float(z[-1])))
    model = Compiled(sensor)
    return model.shown(z[: len(sensor.channels)], model.R)[0]


def causes(sensor: ObservationConfig, z: Floats, R: Floats) -> tuple[Floats, Floats]:
    """What a new landmark follows from, and its covariance: the reading, and a depth from its prior."""
    if sensor.depth is None:
        return z, R
    m = z.shape[0]
    whole = np.zeros((m + 1, m + 1))
    whole[:m, :m], whole[m, m] = R, sensor.depth.sigma**2
    return np.append(z, sensor.depth.mean), whole


@errors
@sensors
def test_new_landmark(sensor: ObservationConfig, error: str) -> None:
    """The rows that a new landmark's error takes from the state's, from the reading's and from a prior's."""
    model = Compiled(sensor)
    space, retraction = model.space, retraction_of(error, model.space)
    for k, y in enumerate(POINTS[space.name]):
        rng = np.random.default_rng(k)
        x = state(space, 2, 12 + k)
        n, z = x.shape[0], model.predict(np.array(y))[0]
        P, R = random_covariance(rng, n, 0.1), random_covariance(rng, z.shape[0], 0.1)
        grown = ekf.augment(retraction, Estimate(x, P), z, R, model)
        at, spread = causes(sensor, z, R)
        if sensor.depth is None:
            assert np.allclose(grown.x[n:], space.transform(space.as_pose(x), np.array(y)), rtol=1e-9)

        def new(both: Floats, x: Floats = x, at: Floats = at, after: Floats = grown.x) -> Floats:
            true = retraction.plus(x, both[: len(x)])
            point = space.transform(space.as_pose(true), shown(sensor, at + both[len(x) :]))
            return retraction.minus(np.concatenate([true, point]), after)[len(x) :]

        J = jacobian(new, np.zeros(n + len(at)), 1e-3)
        assert_close(grown.P[n:, :n], J[:, :n] @ P)
        assert_close(grown.P[n:, n:], J[:, :n] @ P @ J[:, :n].T + J[:, n:] @ spread @ J[:, n:].T)


@sensors
def test_a_reading_turned_into_a_point(sensor: ObservationConfig) -> None:
    """R, and the prior where there is one, carried over by dg/dz."""
    model = Compiled(sensor)
    for y in POINTS[model.space.name]:
        z = model.predict(np.array(y))[0]
        R = random_covariance(np.random.default_rng(3), z.shape[0], 0.1)
        found = inverted(Sighting(0, z, R, model))
        at, spread = causes(sensor, z, R)
        J = jacobian(lambda v: shown(sensor, v), at, 1e-3)
        assert_close(found.R, J @ spread @ J.T)
        if sensor.depth is None:
            assert np.allclose(found.z, y, rtol=1e-9)


@errors
@pytest.mark.parametrize("space", [PLANE, SOLID], ids=lambda space: space.name)
def test_errors(space: Space, error: str) -> None:
    """plus and minus undo each other; T carries to the additive errors; F and G in any dimension."""
    retraction, rng, x = retraction_of(error, space), np.random.default_rng(4), state(space, 3, 5)
    n = int(x.shape[0])
    xi = 0.5 * rng.normal(size=n)
    assert np.allclose(retraction.minus(retraction.plus(x, xi), x), xi, atol=1e-12)
    standard = retraction_of("standard", space)
    assert_close(retraction.additive(x), jacobian(lambda v: standard.minus(retraction.plus(x, v), x), np.zeros(n)))
    step: Floats = np.concatenate([rng.normal(size=space.dim), 0.4 * rng.normal(size=space.rot)])
    moved = after(space, x, step)

    def end(both: Floats) -> Floats:
        true = retraction.plus(x, both[:n])
        return retraction.minus(after(space, true, standard.plus(step, both[n:])), moved)

    J = jacobian(end, np.zeros(n + space.pose))
    F, G = retraction.moved(x, moved)
    whole, grown = np.eye(n), np.zeros((n, space.pose))
    whole[: space.pose, : space.pose], grown[: len(G)] = F, G
    assert_close(whole, J[:, :n])
    assert_close(grown, J[:, n:])


def test_the_process_model_of_the_lecture() -> None:
    pose, control = np.array([3.0, -2.0, 1.1]), np.array([2.0, 0.3])
    _, by_pose, by_noise = process(pose, control, 1.5, DT)
    assert_close(by_pose, jacobian(lambda v: process(v, control, 1.5, DT)[0], pose))
    assert_close(by_noise, jacobian(lambda v: process(pose, v, 1.5, DT)[0], control))


@pytest.mark.parametrize(
    ("f", "q"),
    [
        (SeenRangeBearing(), (4.0, -3.0, 0.4)),
        (SeenRangeBearing(), (-6.0, 0.5, -2.0)),
        (ShownRangeBearing(), (0.4, 7.0, 1.9)),
    ],
)  # fmt: skip
def test_second_derivatives(f: SeenRangeBearing | ShownRangeBearing, q: tuple[float, ...]) -> None:
    at = np.array(q)
    assert_close(f.jacobian(at), jacobian(lambda v: f(v[np.newaxis])[0], at))
    for i, hessian in enumerate(f.hessians(at)):
        assert_close(hessian, jacobian(lambda v, i=i: f.jacobian(v)[i], at))  # type: ignore[misc]
