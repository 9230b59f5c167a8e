"""Without motion: a pose from what is seen alone, and sub-maps that tie by shared landmarks."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from submaps.atlas.placed import additive_covariance
from submaps.config import Camera, MapConfig, MotionConfig, ObservationConfig
from submaps.consistency import average_bounds, nees
from submaps.geometry.space import SOLID
from submaps.mapper import Mapper
from submaps.measurements import Batch
from submaps.observation.models import MODELS, reading, sensor_of

Floats = NDArray[np.float64]
LOOKS_ALONG_X = (0.0, 0.0, 0.0, -0.5, 0.5, -0.5, 0.5)
SENSORS = {
    "cartesian3d": ObservationConfig("cartesian3d", (0.02, 0.02, 0.02)),
    "stereo": ObservationConfig("stereo", (0.5,) * 4, LOOKS_ALONG_X, Camera(480.0, 480.0, 320.0, 240.0, 0.25)),
}
NOWHERE = MotionConfig("none", ())


def config(model: str, max_landmarks: int = 50, gate: float | None = None) -> MapConfig:
    return MapConfig(NOWHERE, SENSORS[model], gate=gate, max_landmarks=max_landmarks, space="se3")


def look(model: str, poses: list[tuple[float, ...]], points: Floats, which: list[list[int]], rng: np.random.Generator,
         noise: float = 1.0) -> Batch:  # fmt: skip
    """What is seen of some points from each pose."""
    sensor = SENSORS[model]
    seen = [(k, i) for k, some in enumerate(which) for i in some]
    z = []
    for k, i in seen:
        body = np.ascontiguousarray(SOLID.transform(SOLID.inverse(poses[k]), points[i]))
        h, _ = reading(SOLID.key, MODELS[model], sensor_of(SOLID, sensor), body)
        z.append(h + noise * rng.normal(size=h.shape) * sensor.sigma)
    return Batch(
        t=np.asarray(np.arange(len(poses)) * 0.1, dtype=np.float64),
        control_step=np.empty(0, dtype=np.int64), control=np.empty((0, 0)),
        control_covariance=None, observation_step=np.array([k for k, _ in seen], dtype=np.int64),
        landmark=tuple(str(i) for _, i in seen), z=np.ascontiguousarray(np.array(z).T), observation_covariance=None,
    )  # fmt: skip


def wander(rng: np.random.Generator, count: int) -> list[tuple[float, ...]]:
    """The origin, and poses that no motion model would lead to."""
    others = np.concatenate([rng.uniform(-1.0, 1.0, (count - 1, 3)), rng.normal(size=(count - 1, 3)) * 0.2], axis=1)
    return [SOLID.origin, *(SOLID.as_pose(p) for p in others)]


def cloud(rng: np.random.Generator, count: int) -> Floats:
    """Points ahead of all of them."""
    return np.asarray(rng.uniform((5.0, -2.0, -2.0), (9.0, 2.0, 2.0), (count, 3)))


def pose_error(true: tuple[float, ...], estimate: tuple[float, ...]) -> Floats:
    """xi with true = exp(xi) estimate in the right-invariant error's coordinates."""
    turn = np.array((Rotation.from_rotvec(true[3:]) * Rotation.from_rotvec(estimate[3:]).inv()).as_rotvec())
    V = SOLID.left_jacobian(turn)
    return np.concatenate([np.linalg.solve(V, true[:3] - SOLID.rotation_of(turn) @ np.array(estimate[:3])), turn])


@pytest.mark.parametrize("model", sorted(SENSORS))
def test_without_noise_each_pose_is_found_exactly_however_far_it_jumps(model: str) -> None:
    rng = np.random.default_rng(1)
    poses, points = wander(rng, 20), cloud(rng, 12)
    which = [list(range(12))] + [rng.permutation(12)[:4].tolist() for _ in range(19)]
    report = Mapper(config(model)).apply("r", look(model, poses, points, which, rng, noise=0.0))
    assert report.rejected == ()
    for true, found in zip(poses, report.track_pose, strict=True):
        assert np.abs(pose_error(true, tuple(found))).max() < 1e-6


@pytest.mark.parametrize("model", sorted(SENSORS))
def test_the_pose_is_as_uncertain_as_it_says(model: str) -> None:
    """NEES of the last of 15 poses, and of the map, over 60 runs."""
    rng = np.random.default_rng(2)
    values, runs = [], 60
    for _ in range(runs):
        poses, points = wander(rng, 15), cloud(rng, 10)
        mapper = Mapper(config(model))
        mapper.apply("r", look(model, poses, points, [list(range(10))] * 15, rng))
        state = mapper.problem().submap(0)
        values.append(nees(pose_error(poses[-1], state.pose), state.covariance(np.arange(6))) / 6.0)
    low, high = average_bounds(0.99, 6, runs)
    assert low < np.mean(values) < high


@pytest.mark.parametrize("model", sorted(SENSORS))
def test_a_step_that_does_not_say_where_it_is_is_lost(model: str) -> None:
    """Fewer than three known landmarks, or three on a line: nothing of the step is used."""
    rng = np.random.default_rng(3)
    poses, points = wander(rng, 5), cloud(rng, 8)
    points[2] = 0.5 * (points[0] + points[1])
    which = [list(range(6)), [0, 1, 6, 7], [0, 1, 2], [0, 1, 3], [4, 6]]
    mapper = Mapper(config(model))
    report = mapper.apply("r", look(model, poses, points, which, rng, noise=0.0))
    assert [(r.step, r.landmark, r.reason) for r in report.rejected] == [
        (1, "0", "lost"), (1, "1", "lost"), (1, "6", "lost"), (1, "7", "lost"),
        (2, "0", "lost"), (2, "1", "lost"), (2, "2", "lost"), (4, "4", "lost"), (4, "6", "lost"),
    ]  # fmt: skip
    assert np.abs(pose_error(poses[3], tuple(report.track_pose[3]))).max() < 1e-6
    assert mapper.problem().submap(0).landmarks.shape[0] == 6


def test_sub_maps_share_landmarks_and_nothing_else() -> None:
    """A full sub-map ends at a pose that says nothing, where the next begins; three known landmarks lie in both."""
    rng = np.random.default_rng(4)
    poses, points = wander(rng, 6), cloud(rng, 14)
    which = [list(range(8)), list(range(8)), list(range(5, 13)), list(range(5, 13)), [9, 10, 11, 12, 13], [9, 10, 11]]
    mapper = Mapper(config("cartesian3d", max_landmarks=8))
    mapper.apply("r", look("cartesian3d", poses, points, which, rng, noise=0.0))
    state = mapper.problem()
    first, second = state.submap(0), state.submap(1)
    assert sorted(set(first.landmarks.tolist()) & set(second.landmarks.tolist())) == [5, 6, 7]
    assert np.abs(pose_error(poses[2], first.pose)).max() < 1e-6  # a guess at where the next begins
    P = additive_covariance(first, list(first.slots().values()), with_pose=True)
    assert np.diag(P)[:6] == pytest.approx([1e6] * 3 + [100.0] * 3)
    assert np.abs(P[:6, 6:]).max() < 1e-6
    assert np.diag(P)[6:].max() < 2.0 * 0.02**2  # the map itself is not forgotten


@pytest.mark.parametrize("model", sorted(SENSORS))
def test_a_map_begins_where_enough_is_seen_to_go_on(model: str) -> None:
    """Two landmarks alone could never place a later pose: the steps before three are seen are lost."""
    rng = np.random.default_rng(5)
    poses, points = wander(rng, 5), cloud(rng, 6)
    poses = [poses[1], poses[2], SOLID.origin, poses[3], poses[4]]
    which = [[0], [0, 1], [0, 1, 2, 3], [0, 1, 2, 4], [1, 2, 3, 4]]
    report = Mapper(config(model)).apply("r", look(model, poses, points, which, rng, noise=0.0))
    assert [(r.step, r.reason) for r in report.rejected] == [(0, "lost"), (1, "lost"), (1, "lost")]
    for true, found in zip(poses[2:], report.track_pose[2:], strict=True):
        assert np.abs(pose_error(true, tuple(found))).max() < 1e-6
