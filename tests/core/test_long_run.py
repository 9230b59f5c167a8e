"""Millions of updates with hardly any noise: the covariance stays symmetric and positive definite."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from submaps.config import FilterName, MapConfig, MotionConfig, ObservationConfig
from submaps.mapper import Mapper
from submaps.measurements import Batch
from tests.core.filters import SENSORS, Kernel
from tests.core.support import R, after

Floats = NDArray[np.float64]
LANDMARKS = 6
CHUNK = 50_000
_angle = 2.0 * np.pi * np.arange(LANDMARKS) / LANDMARKS
WORLD = np.stack([9.0 * np.cos(_angle), 5.0 + 9.0 * np.sin(_angle)], axis=1)


def chunk(rng: np.random.Generator, poses: Floats, increment: Floats | None, begin: int, sigma: float) -> Batch:
    """Observations of one landmark a step, the robot going round ``poses``."""
    at = np.arange(begin, begin + CHUNK)
    pose = poses[at % poses.shape[0]]
    d = WORLD[at % LANDMARKS] - pose[:, :2]
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    z = np.stack([c * d[:, 0] + s * d[:, 1], -s * d[:, 0] + c * d[:, 1]]) + rng.normal(size=(2, CHUNK)) * sigma
    moves = np.arange(1 if begin == 0 else 0, CHUNK) if increment is not None else np.empty(0, dtype=np.int64)
    control = np.empty((3, 0))
    if increment is not None:
        control = increment[:, np.newaxis] + rng.normal(size=(3, moves.shape[0])) * 1e-3
    return Batch(
        t=np.asarray(at * 0.1, dtype=np.float64), control_step=moves, control=np.ascontiguousarray(control),
        control_covariance=None, observation_step=np.arange(CHUNK),
        landmark=tuple(f"p{k % LANDMARKS}" for k in at), z=z, observation_covariance=None,
    )  # fmt: skip


def route(count: int) -> tuple[Floats, Floats]:
    """A closed circle of ``count`` poses, and the increment from each to the next."""
    turn = 2.0 * math.pi / count
    chord = np.array([math.cos(0.5 * turn), math.sin(0.5 * turn)]) * 2.0 * 5.0 * math.sin(0.5 * turn)
    increment = np.array([*chord, turn])
    poses = [np.zeros(3)]
    for _ in range(count - 1):
        poses.append(after(poses[-1], increment))
    return np.array(poses), increment


@pytest.mark.parametrize("name", ["invariant", "standard"])
@pytest.mark.parametrize("patrolling", [False, True], ids=["parked", "patrolling"])
def test_the_covariance_over_a_million_updates(name: FilterName, patrolling: bool) -> None:
    """Four runs of 600 000 updates, one sub-map each."""
    sigma = 1e-3
    config = MapConfig(
        MotionConfig("odometry", (1e-3, 1e-3, 1e-3)), ObservationConfig("cartesian", (sigma, sigma)),
        filter=name, max_heading_sigma=100.0, max_position_sigma=1e6,
    )  # fmt: skip
    rng = np.random.default_rng(0)
    poses, increment = route(60) if patrolling else (np.zeros((1, 3)), None)
    mapper = Mapper(config)
    for begin in range(0, 12 * CHUNK, CHUNK):
        report = mapper.apply("robot", chunk(rng, poses, increment, begin, sigma))
        assert not report.rejected
        submap = mapper.view().state.submap(0)
        P = submap.covariance()
        P[np.diag_indices(3)] -= (1e-8, 1e-8, 1e-10)  # what every snapshot adds
        free = P if patrolling else P[3:, 3:]  # a parked robot knows its pose for certain
        np.linalg.cholesky(free)
        scale = np.sqrt(np.diag(free))
        least = float(np.linalg.eigvalsh(free / np.outer(scale, scale))[0])
        assert least > 1e-9
    x, y, theta = report.pose
    last = poses[(12 * CHUNK - 1) % poses.shape[0]]
    assert math.hypot(x - last[0], y - last[1]) < 5e-3
    assert abs(math.remainder(theta - last[2], 2.0 * math.pi)) < 1e-3
    assert submap.observations == 12 * CHUNK
    assert mapper.view().submap_count == 1
    if not patrolling:  # nothing but averages: sigma^2 / n, and the rounding floor is not to be seen
        expected = sigma**2 / (12 * CHUNK / LANDMARKS)
        assert np.allclose(np.diag(free), expected, rtol=1e-6)
        assert np.allclose(submap.mean[3:].reshape(-1, 2), WORLD, atol=5.0 * math.sqrt(expected))


def test_symmetric_bit_for_bit_after_many_updates() -> None:
    rng = np.random.default_rng(1)
    noise = np.diag([1e-6, 1e-6, 1e-6])
    poses, increment = route(60)
    for invariant in (True, False):
        compiled = Kernel(invariant, replace(SENSORS["cartesian"], mount=(0.0, 0.0, 0.0)))
        for k in range(3000):
            pose, landmark = poses[k % 60], k % LANDMARKS
            z = (WORLD[landmark] - pose[:2]) @ R(pose[2]) + rng.normal(size=2) * 1e-3
            compiled.step(increment if k else None, noise, [(landmark, z)], np.eye(2) * 1e-6)
        assert np.array_equal(compiled.P, compiled.P.T)
        np.linalg.cholesky(compiled.P)
