"""The world of the ``association`` experiment: rounds of a circle among landmarks that look all alike."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from submaps.geometry.se2 import Pose, compose

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

RADIUS, STEPS_A_LAP, LAPS = 15.0, 94, 2.2  # m; a step is a metre
LANDMARKS, BAND, APART = 60, 5.0, 1.5  # within a band (m) either side of the circle, so far apart (m)
SENSOR_RANGE, DETECTED = 6.0, 0.9  # m, probability
ODOMETRY_SIGMA = np.array([0.06, 0.03, math.radians(1.5)])  # m, m, rad of a step
READING_SIGMA = np.array([0.05, math.radians(0.7)])  # m, rad
CLUTTER = -1


@dataclass(frozen=True)
class Scan:
    """One step: the odometry (3,) since the one before, readings (m, 2), and the true pose (3,).

    ``truth`` (m,) says which landmark a reading is of, or ``CLUTTER``.
    """

    increment: Floats
    z: Floats
    truth: Ints
    pose: Floats


@dataclass(frozen=True)
class Drive:
    """A drive, and the covariances that its noise was drawn from: of odometry (3, 3), of a reading (2, 2)."""

    landmarks: Floats
    scans: list[Scan]
    odometry: Floats
    reading: Floats


def simulate(seed: np.random.SeedSequence, noise: float, clutter: float) -> Drive:
    """Drive with ``noise`` times the sigmas and, on average, ``clutter`` false readings a scan."""
    rng = np.random.default_rng(seed)
    landmarks = _scattered(rng)
    turn = 2.0 * math.pi / STEPS_A_LAP
    step = (RADIUS * math.sin(turn), RADIUS * (1.0 - math.cos(turn)), turn)
    pose: Pose = (0.0, 0.0, 0.0)
    scans = []
    for k in range(round(LAPS * STEPS_A_LAP) + 1):
        increment = np.zeros(3)
        if k:
            pose = compose(pose, step)
            increment = np.array(step) + rng.normal(size=3) * ODOMETRY_SIGMA * noise
        scans.append(Scan(increment, *_readings(rng, landmarks, pose, noise, clutter), np.array(pose)))
    return Drive(landmarks, scans, np.diag((ODOMETRY_SIGMA * noise) ** 2), np.diag((READING_SIGMA * noise) ** 2))


def _scattered(rng: np.random.Generator) -> Floats:
    """Landmarks at random near the circle, whose centre lies to the left of the first pose."""
    points = np.empty((0, 2))
    while len(points) < LANDMARKS:
        angle, distance = rng.uniform(0.0, 2.0 * math.pi), RADIUS + rng.uniform(-BAND, BAND)
        point = np.array([distance * math.cos(angle), RADIUS + distance * math.sin(angle)])
        if (np.hypot(*(points - point).T) >= APART).all():
            points = np.vstack([points, point])
    return points


def _readings(
    rng: np.random.Generator, landmarks: Floats, pose: Pose, noise: float, clutter: float
) -> tuple[Floats, Ints]:
    """Range and bearing of what is detected, and of clutter spread evenly over the disc that is seen."""
    x, y, theta = pose
    d = landmarks - (x, y)
    near = np.flatnonzero(np.hypot(*d.T) < SENSOR_RANGE)
    near = near[rng.random(near.size) < DETECTED]
    true = np.stack([np.hypot(*d[near].T), np.arctan2(d[near, 1], d[near, 0]) - theta], axis=1)
    seen = true + rng.normal(size=true.shape) * READING_SIGMA * noise
    false = rng.poisson(clutter)
    stray = np.stack([SENSOR_RANGE * np.sqrt(rng.random(false)), rng.uniform(-math.pi, math.pi, false)], axis=1)
    order = rng.permutation(near.size + false)
    z = np.concatenate([seen, stray])[order]
    return np.column_stack([np.maximum(z[:, 0], 0.05), z[:, 1]]), np.append(near, np.full(false, CLUTTER))[order]
