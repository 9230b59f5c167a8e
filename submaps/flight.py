"""Flights through space, for tests, experiments and measurements: true motion and noisy batches.

Randomness comes from the generator that is handed in, so a seed names a run.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from submaps.config import MapConfig, MotionConfig, ObservationConfig
from submaps.geometry.space import SOLID, Pose
from submaps.measurements import Batch
from submaps.observation.models import MODELS, reading, sensor_of

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Volume:
    """A flight through points: true body-frame increments, and what a sensor may see.

    ``increments`` (n, 6) (position m, rotation vector rad) lead from each pose to the next, the first pose being
    the origin; ``landmarks`` (m, 3) are seen within ``sensor_range`` (m) after every step, and only within
    ``view``, an axis of the body (0, 1, 2) and an angle (rad) from it. Noise is relative: sigma of each number of an
    increment's position, of its rotation and of a reading's is ``share`` of the size of that vector, or ``each`` of
    the number itself.
    """

    landmarks: Floats
    increments: Floats
    sensor_range: float
    share: float
    view: tuple[int, float] | None = None
    each: bool = False


@dataclass(frozen=True)
class Flight:
    """One simulated flight: its batch of measurements and its true poses (n + 1, 6), the first the origin."""

    batch: Batch
    poses: Floats


def loops(rng: np.random.Generator, landmarks: int = 300, steps: int = 500, share: float = 0.05) -> Volume:
    """Two and a half rounds of 20 m radius that rise and fall, among points scattered around the way.

    Rising and falling by 2.5 m seven times a round; landmarks lie within 5 m of the way along each axis and are
    seen within 5 m.
    """
    rounds, radius = 2.5, 20.0
    angle = 2.0 * np.pi * rounds * np.arange(steps + 1) / steps
    path = np.stack([radius * np.sin(angle), radius * (1.0 - np.cos(angle)), 2.5 * np.sin(7.0 * angle / rounds)], 1)
    poses = [_looking(path[k], path[k + 1]) for k in range(steps)]
    poses.append((*path[-1], *poses[-1][3:]))
    around = path[rng.integers(0, steps, landmarks)] + rng.uniform(-5.0, 5.0, (landmarks, 3))
    return _volume(poses, around, 5.0, share)


def tumbling(rng: np.random.Generator, landmarks: int = 300, steps: int = 500, share: float = 0.05) -> Volume:
    """The world of Zhang et al., "Convergence and consistency analysis for a 3-D invariant-EKF SLAM", RA-L 2(2) 2017.

    As far as their released simulation tells (github.com/RomaTeng/EKF-SLAM-on-Manifold, datagen_3d): step k at (50
    cos 0.3k, 40 sin 0.2k, 20 sin(0.2k + 1)) m, turned by roll 0.5k + 2, pitch -0.3k, yaw 0.4k rad, that is 12 m and
    0.67 rad a step on average, the way closing every 63 steps; landmarks evenly in the box of the way and 30 m around
    it, seen within 25 m and 120 degrees of the body's z axis. The noise of each number is ``share`` of its size.
    """
    k = np.arange(steps + 1)
    path = np.stack([50.0 * np.cos(0.3 * k), 40.0 * np.sin(0.2 * k), 20.0 * np.sin(0.2 * k + 1.0)], axis=1)
    turns = Rotation.from_euler("ZYX", np.stack([0.4 * k, -0.3 * k, 0.5 * k + 2.0], axis=1))
    poses = [SOLID.as_pose(pose) for pose in np.hstack([path, turns.as_rotvec()])]
    points = rng.uniform(path.min(axis=0) - 30.0, path.max(axis=0) + 30.0, (landmarks, 3))
    return _volume(poses, points, 25.0, share, (2, math.radians(120.0)), each=True)


def _volume(
    poses: list[Pose],
    points: Floats,
    sensor_range: float,
    share: float,
    view: tuple[int, float] | None = None,
    *,
    each: bool = False,
) -> Volume:
    """A flight along poses (n + 1) among points (m, 3), both in one frame."""
    increments = np.array([SOLID.between(a, b) for a, b in pairwise(poses)])
    local = SOLID.transform(SOLID.inverse(poses[0]), points)
    return Volume(local, increments, sensor_range, share, view, each)


def _looking(at: Floats, towards: Floats) -> Pose:
    """The pose at a point whose x axis looks at another, its y axis level."""
    x = (towards - at) / np.linalg.norm(towards - at)
    y = np.cross([0.0, 0.0, 1.0], x)
    y /= np.linalg.norm(y)
    return SOLID.as_pose(np.concatenate([at, SOLID.angles_of(np.stack([x, y, np.cross(x, y)], axis=1))]))


def config_of(volume: Volume, one_map: bool, filter: str = "invariant") -> MapConfig:
    """A map of a flight with Cartesian readings; its noise comes with the measurements."""
    bounds = (1000, 1e9, 1e9) if one_map else (50, 0.010, 0.15)
    return MapConfig(
        MotionConfig("odometry3d", (volume.share,) * 6), ObservationConfig("cartesian3d", (volume.share,) * 3),
        "invariant" if filter == "invariant" else "standard", max_landmarks=bounds[0], max_heading_sigma=bounds[1],
        max_position_sigma=bounds[2], space="se3",
    )  # fmt: skip


def fly(volume: Volume, rng: np.random.Generator, sensor: ObservationConfig | None = None) -> Flight:
    """Fly once: exact poses for truth, noise on increments and on each sighting.

    Readings are Cartesian with the volume's relative noise, or those of a ``sensor`` with its own.
    """
    poses = [SOLID.origin]
    for step in volume.increments:
        poses.append(SOLID.compose(poses[-1], SOLID.as_pose(step)))
    control, noise = _noisy(volume, rng)
    seen_at, names, z, R = [], [], [], []
    for k in range(1, len(poses)):
        local = (volume.landmarks - poses[k][:3]) @ SOLID.rotation(poses[k])
        for i in np.flatnonzero(_in_view(volume, local)):
            shown, covariance = _sighting(local[i], volume, sensor, rng)
            seen_at.append(k)
            names.append(str(i))
            z.append(shown)
            R.append(covariance)
    count = len(poses)
    batch = Batch(
        t=np.arange(count, dtype=np.float64), control_step=np.arange(1, count), control=np.ascontiguousarray(control.T),
        control_covariance=noise, observation_step=np.array(seen_at, dtype=np.int64), landmark=tuple(names),
        z=np.ascontiguousarray(np.array(z).T), observation_covariance=np.array(R),
    )  # fmt: skip
    return Flight(batch, np.array(poses))


def _in_view(volume: Volume, local: Floats) -> NDArray[np.bool_]:
    """Which points (m, 3) in the body frame are seen."""
    distance = np.linalg.norm(local, axis=1)
    near: NDArray[np.bool_] = distance <= volume.sensor_range
    if volume.view is None:
        return near
    axis, angle = volume.view
    inside: NDArray[np.bool_] = local[:, axis] > distance * math.cos(angle)
    return near & inside


def _sigma(volume: Volume, vectors: Floats) -> Floats:
    """Standard deviations of the numbers of vectors (n, 3)."""
    sizes = np.abs(vectors) if volume.each else np.repeat(np.linalg.norm(vectors, axis=1, keepdims=True), 3, axis=1)
    return np.asarray(volume.share * sizes)


def _noisy(volume: Volume, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Readings (n, 6) of the increments, and their covariances (n, 6, 6)."""
    move, turn = volume.increments[:, :3], volume.increments[:, 3:]
    sigma = np.hstack([_sigma(volume, move), _sigma(volume, turn)])
    readings = volume.increments + rng.normal(size=sigma.shape) * sigma
    return readings, np.stack([np.diag(s * s) for s in sigma])


def _sighting(
    local: Floats, volume: Volume, sensor: ObservationConfig | None, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """The noisy reading of a point in the body frame, with its covariance.

    The covariance follows from the true size: one that followed from the reading would weigh those more that came
    out small.
    """
    if sensor is None:
        sigma = _sigma(volume, local[np.newaxis])[0]
        return local + rng.normal(size=3) * sigma, np.diag(sigma * sigma)
    h, _ = reading(SOLID.key, MODELS[sensor.model], sensor_of(SOLID, sensor), local)
    own = np.array(sensor.sigma)
    return h + rng.normal(size=own.shape) * own, np.diag(own * own)
