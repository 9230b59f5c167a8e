"""The paper's world: 32 points on two planes, and a camera that winds around them (its Figure 1).

What the paper leaves open is chosen here: planes at right angles through the vertical axis, four turns
of a helix. The camera looks at that axis, which its own meets at a right angle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from submaps.nonodometry.poses import Poses
from submaps.nonodometry.sensor import Sensor

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Spiral:
    """True points (32, 3) m and camera poses (n), evenly spaced along the spiral."""

    points: Floats
    poses: Poses


def spiral(views: int = 200, turns: float = 4.0, radius: float = 3.0, height: float = 1.5, side: float = 1.5) -> Spiral:
    """Four by four points on each plane, ``side`` m wide; ``views`` poses from ``height``/2 below to as much above."""
    along = np.linspace(-0.5 * side, 0.5 * side, 4)
    across, up = (part.ravel() for part in np.meshgrid(along, along))
    none = np.zeros(16)
    points = np.concatenate([np.stack([across, none, up], axis=1), np.stack([none, across, up], axis=1)])
    angle = np.linspace(0.0, 2.0 * np.pi * turns, views)
    level = np.linspace(-0.5 * height, 0.5 * height, views)
    position = np.stack([radius * np.cos(angle), radius * np.sin(angle), level], axis=1)
    forward = np.stack([-np.cos(angle), -np.sin(angle), np.zeros(views)], axis=1)
    down = np.broadcast_to([0.0, 0.0, -1.0], forward.shape)
    return Spiral(points, Poses(np.stack([np.cross(down, forward), down, forward], axis=-1), position))


def observe(world: Spiral, sensor: Sensor, rng: np.random.Generator) -> Floats:
    """All views of all points (views, 32, d), with noise."""
    exact = np.swapaxes(sensor.observe(world.poses.to_body(world.points)), -1, -2)
    return np.asarray(exact + rng.normal(size=exact.shape) * sensor.sigma)
