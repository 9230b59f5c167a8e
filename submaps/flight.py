"""Flights through space, for tests, experiments and measurements: true motion and noisy batches.

Randomness comes from the generator that is handed in, so a seed names a run.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from submaps.config import MapConfig, MotionConfig, ObservationConfig
from submaps.geometry.space import SOLID, Pose
from submaps.measurements import Batch
from submaps.observation.models import MODELS, reading, sensor_of

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Volume:
    """A flight through points: true body-frame increments, and what a sensor may see.

    ``increments`` (n, 6) (position m, rotation vector rad) lead from each pose to the next, the first pose being
    the origin; ``landmarks`` (m, 3) are seen within ``sensor_range`` (m) after every step, and only ahead (x > 0
    in the body) where ``ahead``. Noise is relative: sigma of each number of an increment's position, of its
    rotation and of a reading's is ``share`` of the size of that vector, as in Zhang et al., arXiv:1702.06680.
    """

    landmarks: Floats
    increments: Floats
    sensor_range: float
    share: float
    ahead: bool = False


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
    increments = np.array([SOLID.between(a, b) for a, b in itertools.pairwise(poses)])
    around = path[rng.integers(0, steps, landmarks)] + rng.uniform(-5.0, 5.0, (landmarks, 3))
    local = np.array([SOLID.transform(SOLID.inverse(poses[0]), point) for point in around])
    return Volume(local, increments, 5.0, share)


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
        near = np.linalg.norm(local, axis=1) <= volume.sensor_range
        for i in np.flatnonzero(near & (local[:, 0] > 0.0) if volume.ahead else near):
            shown, covariance = _sighting(local[i], volume.share, sensor, rng)
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


def _noisy(volume: Volume, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Readings (n, 6) of the increments, and their covariances (n, 6, 6)."""
    move, turn = volume.increments[:, :3], volume.increments[:, 3:]
    sizes = np.stack([np.linalg.norm(move, axis=1), np.linalg.norm(turn, axis=1)], axis=1)
    sigma = volume.share * np.repeat(sizes, 3, axis=1)
    readings = volume.increments + rng.normal(size=sigma.shape) * sigma
    return readings, np.stack([np.diag(s * s) for s in sigma])


def _sighting(
    local: Floats, share: float, sensor: ObservationConfig | None, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """The noisy reading of a point in the body frame, with its covariance."""
    if sensor is None:
        sigma = share * np.linalg.norm(local)
        return local + rng.normal(size=3) * sigma, np.eye(3) * sigma**2
    h, _ = reading(SOLID.key, MODELS[sensor.model], sensor_of(SOLID, sensor), local)
    own = np.array(sensor.sigma)
    return h + rng.normal(size=own.shape) * own, np.diag(own * own)
