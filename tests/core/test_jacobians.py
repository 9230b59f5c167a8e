"""Every derivative of a model against central differences, under both errors: one row a model.

A row of ``MOTIONS`` or ``OBSERVATIONS`` is all that a new model needs here.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

from submaps.config import MotionConfig
from submaps.geometry.space import PLANE, SOLID, Space
from submaps.reference import ekf
from submaps.reference.compiled import Compiled
from submaps.reference.ekf import Estimate
from submaps.reference.flatland import process
from submaps.reference.moments import SeenRangeBearing, ShownRangeBearing
from submaps.reference.motion import increment
from submaps.reference.observation import Observation, Point, Sighting, inverted
from submaps.reference.retraction import RETRACTIONS, Retraction, after
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


@dataclass(frozen=True)
class Seen:
    """A row: an observation model, its space, and points in view of it (body frame, m)."""

    name: str
    model: Observation
    space: Space
    points: tuple[tuple[float, ...], ...]


MOTIONS = [
    Motion("odometry", MotionConfig("odometry", (0.1, 0.1, 0.1)), (1.0, -0.3, 0.4)),
    Motion("velocity", MotionConfig("velocity", (0.1, 0.1)), (1.3, 0.6)),
    Motion("velocity, straight", MotionConfig("velocity", (0.1, 0.1)), (1.3, 0.0)),
    Motion("bicycle", MotionConfig("bicycle", (0.1, 0.1), wheelbase=1.5), (2.0, 0.3)),
    Motion("ackermann", MotionConfig("ackermann", (0.1, 0.1), wheelbase=2.8, encoder_offset=0.7), (2.0, -0.4)),
]  # fmt: skip
AROUND = ((10.0, 4.0), (-7.0, 2.0), (3.0, -9.0), (-8.0, -8.0))
MOUNT = (0.7, -0.3, 0.4)
OBSERVATIONS = [
    Seen("point", Point(), PLANE, AROUND),
    Seen("point in space", Point(), SOLID, ((6.0, 1.0, -2.0), (-4.0, 5.0, 3.0))),
    Seen("cartesian", Compiled("cartesian", MOUNT), PLANE, AROUND),
    Seen("range_bearing", Compiled("range_bearing", MOUNT), PLANE, AROUND),
]  # fmt: skip

motions = pytest.mark.parametrize("row", MOTIONS, ids=lambda row: row.name)
observations = pytest.mark.parametrize("row", OBSERVATIONS, ids=lambda row: row.name)
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
    retraction, x = retraction_of(error, PLANE), state(PLANE, 3, 1)
    n, channels = x.shape[0], len(row.control)
    moved = after(PLANE, x, increment(row.config, row.control, DT)[0])

    def end(both: Floats) -> Floats:
        true = retraction.plus(x, both[:n])
        done, _ = increment(row.config, (row.control + both[n:]).tolist(), DT)
        return retraction.minus(after(PLANE, true, done), moved)

    J = jacobian(end, np.zeros(n + channels))
    F, G = retraction.moved(x, moved)
    whole = np.eye(n)
    whole[:3, :3] = F
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
@observations
def test_observation(row: Seen, error: str) -> None:
    """H = dh/dy [dy/dpose, ..., dy/dl, ...]."""
    space, retraction = row.space, retraction_of(error, row.space)
    for k, y in enumerate(row.points):
        x = state(space, 3, 2 + k)
        slot = space.pose + space.dim
        x[slot : slot + space.dim] = space.transform(space.as_pose(x), np.array(y))
        z = row.model.predict(np.array(y))[0]

        def reading(xi: Floats, x: Floats = x, z: Floats = z, slot: int = slot) -> Floats:
            moved = retraction.plus(x, xi)
            point = space.transform(space.inverse(space.as_pose(moved)), moved[slot : slot + space.dim])
            return row.model.innovation(row.model.predict(point)[0], z)

        v, H, _ = ekf.linearised(retraction, x, [Sighting(slot, z, np.eye(z.shape[0]), row.model)])
        assert np.abs(v).max() < 1e-9 * np.abs(z).max()
        assert_close(H, jacobian(reading, np.zeros(x.shape[0]), 1e-3))


@errors
@observations
def test_new_landmark(row: Seen, error: str) -> None:
    """The rows that a new landmark's error takes from the state's and from the reading's."""
    space, retraction = row.space, retraction_of(error, row.space)
    for k, y in enumerate(row.points):
        rng = np.random.default_rng(k)
        x = state(space, 2, 12 + k)
        n, z = x.shape[0], row.model.predict(np.array(y))[0]
        m = z.shape[0]
        P, R = random_covariance(rng, n, 0.1), random_covariance(rng, m, 0.1)
        grown = ekf.augment(retraction, Estimate(x, P), z, R, row.model)
        assert np.allclose(grown.x[n:], space.transform(space.as_pose(x), np.array(y)), rtol=1e-9)

        def shown(both: Floats, x: Floats = x, z: Floats = z, after: Floats = grown.x) -> Floats:
            true = retraction.plus(x, both[: len(x)])
            point = space.transform(space.as_pose(true), row.model.invert(z + both[len(x) :])[0])
            return retraction.minus(np.concatenate([true, point]), after)[len(x) :]

        J = jacobian(shown, np.zeros(n + m), 1e-3)
        assert_close(grown.P[n:, :n], J[:, :n] @ P)
        assert_close(grown.P[n:, n:], J[:, :n] @ P @ J[:, :n].T + J[:, n:] @ R @ J[:, n:].T)


@observations
def test_a_reading_turned_into_a_point(row: Seen) -> None:
    """R carried over by dg/dz, the inverse of dh/dy."""
    for y in row.points:
        z, by_y = row.model.predict(np.array(y))
        R = random_covariance(np.random.default_rng(3), z.shape[0], 0.1)
        found = inverted(Sighting(0, z, R, row.model))
        J = jacobian(lambda v: row.model.invert(v)[0], z, 1e-3)
        assert np.allclose(found.z, y, rtol=1e-9)
        assert_close(found.R, J @ R @ J.T)
        assert_close(J @ by_y, np.eye(row.space.dim))


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
