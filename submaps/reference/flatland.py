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


@dataclass(frozen=True)
class Field:
    """Laps of a bicycle round a circle of ``radius`` (m), ``landmarks`` scattered within ``aside`` (m) of it.

    Speed 2 m/s, wheelbase 1.5 m, dt 0.2 s; landmarks are seen within ``reach`` (m) at every second step.
    """

    laps: float
    radius: float
    landmarks: int
    aside: float
    reach: float
    control_sigma: tuple[float, float]
    reading_sigma: tuple[float, float]

    def planted(self, rng: np.random.Generator) -> Flatland:
        """One such field, its landmarks drawn anew."""
        speed, wheelbase, dt = 2.0, 1.5, 0.2
        steps = round(self.laps * 2.0 * math.pi * self.radius / (speed * dt))
        steer = math.asin(wheelbase / self.radius)
        count = self.landmarks
        angle = 2.0 * math.pi * (np.arange(count) + rng.uniform(-0.4, 0.4, count)) / count
        distance = self.radius + rng.uniform(-self.aside, self.aside, count)
        # The front wheel starts at the origin and rolls along heading + steer.
        centre = self.radius * np.array([-math.sin(steer), math.cos(steer)])
        points = centre + distance[:, np.newaxis] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        controls = np.tile([speed, steer], (steps, 1))
        return Flatland(points, controls, wheelbase, dt, self.reach, 2, self.control_sigma, self.reading_sigma)


# Two laps among many landmarks; and one and a half among few, so that the loop closes late and hard.
NEAR = Field(2.0, 30.0, 60, 8.0, 10.0, (0.2, math.radians(2.0)), (0.2, math.radians(2.0)))
FAR = Field(1.5, 40.0, 50, 6.0, 8.0, (0.2, math.radians(1.5)), (0.2, math.radians(2.0)))
