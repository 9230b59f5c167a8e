"""Residuals of a batch problem and their derivatives, many rows at a time.

Additive everywhere: a step leaves (R_aᵀ(p_b − p_a), θ_b − θ_a) − u, a reading h(R_aᵀ(l − p_a)) − z,
angles wrapped. Each row is whitened by W with Wᵀ W the inverse of its covariance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps.config import ObservationConfig
from submaps.trajectory import wrapped

Floats = NDArray[np.float64]

# (1e-4 m)², (1e-5 rad)²: an arc without slip is singular
_LEAST_NOISE = {2: np.diag([1e-8] * 2), 3: np.diag([1e-8, 1e-8, 1e-10]), 6: np.diag([1e-8] * 3 + [1e-10] * 3)}


def moved(before: Floats, after: Floats, increment: Floats, root: Floats) -> tuple[Floats, Floats]:
    """Residuals (c, 3) of steps and their derivatives (c, 3, 6) by the poses (c, 3) before and after."""
    c, s = np.cos(before[:, 2]), np.sin(before[:, 2])
    body = rotated(-before[:, 2], after[:, :2] - before[:, :2])
    residual = np.column_stack([body, after[:, 2] - before[:, 2]]) - increment
    residual[:, 2] = wrapped(residual[:, 2])
    by = np.zeros((len(before), 3, 6))
    by[:, 0, 3], by[:, 0, 4], by[:, 1, 3], by[:, 1, 4], by[:, 2, 5] = c, s, -s, c, 1.0
    by[:, :, :2] = -by[:, :, 3:5]
    by[:, 0, 2], by[:, 1, 2], by[:, 2, 2] = body[:, 1], -body[:, 0], -1.0
    return np.einsum("nij,nj->ni", root, residual), root @ by


def seen(pose: Floats, point: Floats, observation: ObservationConfig, z: Floats, root: Floats) -> tuple[Floats, Floats]:
    """Residuals (m, 2) of readings (m, 2) and their derivatives (m, 2, 5) by pose (m, 3) and point (m, 2)."""
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    body = rotated(-pose[:, 2], point - pose[:, :2])
    by = np.zeros((len(pose), 2, 5))
    by[:, 0, 3], by[:, 0, 4], by[:, 1, 3], by[:, 1, 4] = c, s, -s, c
    by[:, :, :2] = -by[:, :, 3:]
    by[:, 0, 2], by[:, 1, 2] = body[:, 1], -body[:, 0]
    predicted, by_body = _predict(observation, body)
    residual = predicted - z
    if observation.model == "range_bearing":
        residual[:, 1] = wrapped(residual[:, 1])
    return np.einsum("nij,nj->ni", root, residual), root @ by_body @ by


def _predict(observation: ObservationConfig, body: Floats) -> tuple[Floats, Floats]:
    """Readings h(y) (m, 2) of body-frame points, and dh/dy (m, 2, 2)."""
    x, y, angle = observation.mount
    sensor = rotated(-angle, body - (x, y))
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    if observation.model == "cartesian":
        return sensor, np.broadcast_to(turn, (body.shape[0], 2, 2))
    distance = np.hypot(sensor[:, 0], sensor[:, 1])
    along = sensor / distance[:, None]
    across = np.column_stack([-along[:, 1], along[:, 0]]) / distance[:, None]
    reading = np.column_stack([distance, np.arctan2(sensor[:, 1], sensor[:, 0])])
    return reading, np.stack([along, across], axis=1) @ turn


def to_body(observation: ObservationConfig, z: Floats) -> Floats:
    """The body-frame points (m, 2) that readings (m, 2) show."""
    x, y, angle = observation.mount
    if observation.model == "range_bearing":
        z = z[:, :1] * np.column_stack([np.cos(z[:, 1]), np.sin(z[:, 1])])
    point: Floats = rotated(angle, z) + np.array([x, y])
    return point


def composed(pose: Floats, increment: Floats) -> Floats:
    """A pose (3,) moved by an increment (3,) in its frame, the heading not wrapped."""
    x, y, theta = pose
    c, s = np.cos(theta), np.sin(theta)
    dx, dy, dtheta = increment
    return np.array([x + c * dx - s * dy, y + s * dx + c * dy, theta + dtheta])


def to_map(pose: Floats, body: Floats) -> Floats:
    """Points (m, 2) in the bodies of poses (m, 3), in the frame of these."""
    return pose[:, :2] + rotated(pose[:, 2], body)


def moved_back(poses: Floats, errors: Floats) -> Floats:
    """Poses (n, 3) less errors (n, 3)."""
    return poses - errors


def information_root(covariance: Floats) -> Floats:
    """W with Wᵀ W the inverse of each covariance (n, d, d); where one is singular, all get a little more."""
    try:
        root = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        root = np.linalg.cholesky(covariance + _LEAST_NOISE.get(covariance.shape[1], 0.0))
    inverse: Floats = np.linalg.inv(root)
    return inverse


def rotated(angle: Floats | float, points: Floats) -> Floats:
    """Points (n, 2) turned by one angle or by one each (rad)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.column_stack([c * points[:, 0] - s * points[:, 1], s * points[:, 0] + c * points[:, 1]])
