"""Flatland of the SLAM lecture (COMP0130, 6A): a bicycle in the plane among landmarks that it can tell apart.

The process model as it stands on the slides, and a world to drive in. The main path's ``bicycle`` is
the same model as a body-frame increment.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from submaps.config import MotionConfig, ObservationConfig
from submaps.measurements import Batch

Floats = NDArray[np.float64]


def process(pose: Floats, control: Floats, wheelbase: float, dt: float) -> tuple[Floats, Floats, Floats]:
    """f(x, u), grad f_x (3, 3) and grad f_v (3, 2) of the pose (x m, y m, psi rad) and u = (s m/s, delta rad).

    x + s dt cos(psi + delta), y + s dt sin(psi + delta), psi + s dt sin(delta) / B; the noise v is added
    to the control.
    """
    x, y, psi = pose.tolist()
    s, delta = control.tolist()
    c, n = math.cos(psi + delta), math.sin(psi + delta)
    moved = np.array([x + s * dt * c, y + s * dt * n, psi + s * dt * math.sin(delta) / wheelbase])
    by_pose = np.array([[1.0, 0.0, -s * dt * n], [0.0, 1.0, s * dt * c], [0.0, 0.0, 1.0]])
    by_noise = np.array([
        [dt * c, -s * dt * n],
        [dt * n, s * dt * c],
        [dt * math.sin(delta) / wheelbase, s * dt * math.cos(delta) / wheelbase],
    ])  # fmt: skip
    return moved, by_pose, by_noise


@dataclass(frozen=True)
class Flatland:
    """A field of landmarks (m, 2) and a bicycle that follows the controls (n, 2), (speed m/s, steer rad).

    Landmarks are seen within ``reach`` (m) after every ``observe_every``-th step of ``dt`` (s).
    ``control_sigma`` is that of (speed, steer), ``reading_sigma`` that of (range m, bearing rad).
    """

    landmarks: Floats
    controls: Floats
    wheelbase: float
    dt: float
    reach: float
    observe_every: int
    control_sigma: tuple[float, float]
    reading_sigma: tuple[float, float]

    @property
    def motion(self) -> MotionConfig:
        """The process model, as a map is told it."""
        return MotionConfig("bicycle", self.control_sigma, wheelbase=self.wheelbase)

    @property
    def observation(self) -> ObservationConfig:
        """The observation model, as a map is told it."""
        return ObservationConfig("range_bearing", self.reading_sigma)

    def drive(self, rng: np.random.Generator) -> tuple[Batch, Floats]:
        """One drive: what is measured, and the true poses (n + 1, 3), the first at the origin.

        The controls are what was ordered and is told; the vehicle does them with noise.
        """
        steps = self.controls.shape[0]
        done = self.controls + rng.normal(size=(steps, 2)) * self.control_sigma
        poses = np.zeros((steps + 1, 3))
        for k in range(steps):
            poses[k + 1], _, _ = process(poses[k], done[k], self.wheelbase, self.dt)
        seen_at: list[int] = []
        names: list[str] = []
        readings = []
        for k in range(0, steps + 1, self.observe_every):
            apart = self.landmarks - poses[k, :2]
            distance = np.hypot(apart[:, 0], apart[:, 1])
            bearing = np.arctan2(apart[:, 1], apart[:, 0]) - poses[k, 2]
            near = np.flatnonzero(distance <= self.reach)
            noise = rng.normal(size=(near.shape[0], 2)) * self.reading_sigma
            seen_at += [k] * near.shape[0]
            names += map(str, near.tolist())
            readings.append(np.column_stack([distance[near], bearing[near]]) + noise)
        batch = Batch(
            t=np.arange(steps + 1) * self.dt, control_step=np.arange(1, steps + 1),
            control=np.ascontiguousarray(self.controls.T), control_covariance=None,
            observation_step=np.array(seen_at, dtype=np.int64), landmark=tuple(names),
            z=np.ascontiguousarray(np.concatenate(readings).T), observation_covariance=None,
        )  # fmt: skip
        return batch, poses


def field(rng: np.random.Generator, laps: float = 2.0, radius: float = 25.0, landmarks: int = 60) -> Flatland:
    """Laps of a bicycle round a field of scattered landmarks: speed 2 m/s, wheelbase 1.5 m, dt 0.2 s.

    Landmarks lie within 8 m of the circle and are seen within 10 m at every second step; sigma 0.2 m/s
    and 1.5 degrees of the control, 0.15 m and 1.5 degrees of a reading.
    """
    speed, wheelbase, dt = 2.0, 1.5, 0.2
    steps = round(laps * 2.0 * math.pi * radius / (speed * dt))
    steer = math.asin(wheelbase / radius)
    angle = 2.0 * math.pi * (np.arange(landmarks) + rng.uniform(-0.4, 0.4, landmarks)) / landmarks
    distance = radius + rng.uniform(-8.0, 8.0, landmarks)
    # The front wheel starts at the origin and rolls along heading + steer.
    centre = radius * np.array([-math.sin(steer), math.cos(steer)])
    points = centre + distance[:, np.newaxis] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    sigma = math.radians(1.5)
    return Flatland(
        points, np.tile([speed, steer], (steps, 1)), wheelbase, dt, 10.0, 2, (0.2, sigma), (0.15, sigma)
    )  # fmt: skip
