"""Worlds and sensors for tests, experiments and load: true motion, noisy batches.

Randomness comes from the generator that is handed in, so a seed names a run.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from submaps.geometry.se2 import ORIGIN, Pose, compose, exp
from submaps.measurements import Batch

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class World:
    """A drive through landmarks: true body-frame velocities and what a sensor may see.

    ``velocity`` (n, 2) is (v m/s, omega rad/s) over each interval ``dt``; a landmark (m, 2) is seen
    within ``sensor_range`` (m) after every ``observe_every``-th step. Noise is that of one reading:
    ``velocity_sigma`` (m/s, rad/s), ``observation_sigma`` (m) for x and y alike. The first pose is
    ``start`` (x m, y m, theta rad).
    """

    landmarks: Floats
    velocity: Floats
    dt: float
    sensor_range: float
    observe_every: int
    velocity_sigma: tuple[float, float]
    observation_sigma: float
    start: Pose = ORIGIN


@dataclass(frozen=True)
class Run:
    """One simulated drive: its batch of measurements and its true poses (n, 3), the first at the start."""

    batch: Batch
    poses: Floats


def circle(laps: float = 1.1, radius: float = 20.0, count: int = 20) -> World:
    """The world that tells filters apart: a circle with landmarks alternately inside and outside.

    1 m/s, dt 0.1 s, landmarks 3 m off the path seen within 4 m at every fifth step, sigma 0.05 m/s,
    5 deg/s, 0.25 m. The first pose is the origin, the circle's centre lies ``radius`` to the left.
    """
    steps = round(laps * 2.0 * np.pi * radius / 0.1)
    angle = 2.0 * np.pi * (np.arange(count) + 0.5) / count - 0.5 * np.pi
    distance = radius + np.where(np.arange(count) % 2 == 0, -3.0, 3.0)
    landmarks = np.stack([distance * np.cos(angle), radius + distance * np.sin(angle)], axis=1)
    velocity = np.tile([1.0, 1.0 / radius], (steps, 1))
    return World(landmarks, velocity, 0.1, 4.0, 5, (0.05, float(np.deg2rad(5.0))), 0.25)


def two_ways(rng: np.random.Generator, steps: int = 1300, apart: float = 100.0) -> dict[str, Run]:
    """Two robots that start ``apart`` metres from each other and drive towards and past each other.

    0.5 m/s in gentle bends, dt 0.1 s, 130 landmarks along the way seen within 6 m at every fifth step,
    sigma 0.05 m/s, 1 deg/s, 0.15 m. Both poses are in one frame, which ``east`` starts at.
    """
    along = rng.uniform(-0.1 * apart, 1.2 * apart, 130)
    landmarks = np.stack([along, rng.uniform(-8.0, 8.0, 130)], axis=1)
    turn = 0.1 * np.cos(0.02 * np.arange(steps))
    runs = {}
    for name, start, sign in (("east", ORIGIN, 1.0), ("west", (apart, 0.0, np.pi), -1.0)):
        velocity = np.stack([np.full(steps, 0.5), sign * turn], axis=1)
        world = World(landmarks, velocity, 0.1, 6.0, 5, (0.05, float(np.deg2rad(1.0))), 0.15, start)
        runs[name] = drive(world, rng)
    return runs


def drive(world: World, rng: np.random.Generator) -> Run:
    """Drive once through a world: exact arcs for truth, noise on velocities and on each sighting.

    The batch has a step for the first pose, without control, and one for each interval; its controls
    are (v, omega) and its observations Cartesian, both for ``MapConfig`` models of those names.
    """
    steps = world.velocity.shape[0]
    poses = np.empty((steps + 1, 3))
    poses[0] = pose = world.start
    for k, (v, omega) in enumerate(world.velocity):
        pose = compose(pose, exp((v * world.dt, 0.0, omega * world.dt)))
        poses[k + 1] = pose
    control = world.velocity + rng.normal(size=(steps, 2)) * world.velocity_sigma
    seen_at, names, readings = [], [], []
    for k in range(0, steps + 1, world.observe_every):
        x, y, theta = poses[k]
        c, s = np.cos(theta), np.sin(theta)
        local = (world.landmarks - (x, y)) @ np.array([[c, -s], [s, c]])
        for i in np.flatnonzero(np.hypot(local[:, 0], local[:, 1]) <= world.sensor_range):
            seen_at.append(k)
            names.append(str(i))
            readings.append(local[i] + rng.normal(size=2) * world.observation_sigma)
    batch = Batch(
        t=np.arange(steps + 1) * world.dt,
        control_step=np.arange(1, steps + 1),
        control=np.ascontiguousarray(control.T),
        control_covariance=None,
        observation_step=np.array(seen_at, dtype=np.int64),
        landmark=tuple(names),
        z=np.ascontiguousarray(np.array(readings).reshape(-1, 2).T),
        observation_covariance=None,
    )
    return Run(batch, poses)
