"""Residuals of a batch problem in space and their derivatives, many rows at a time; ``residuals`` has the plane's.

A pose's error is that of ``geometry.space``: p + e_p, exp(e_theta) R. A step leaves (R_aᵀ(p_b − p_a) − d, e) with
R_aᵀ R_b = exp(e) exp(r), a reading h(R_aᵀ(l − p_a)) − z. Each row is whitened by W with Wᵀ W the inverse of its
covariance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from submaps.config import ObservationConfig
from submaps.geometry import so3
from submaps.geometry.space import SOLID
from submaps.observation.models import MODELS, reading, sensor_of, shown

Floats = NDArray[np.float64]


def moved(before: Floats, after: Floats, increment: Floats, root: Floats) -> tuple[Floats, Floats]:
    """Residuals (c, 6) of steps and their derivatives (c, 6, 12) by the errors of the poses (c, 6) before and after."""
    turned, way = Rotation.from_rotvec(before[:, 3:]), after[:, :3] - before[:, :3]
    back = turned.inv().as_matrix()
    rest = turned.inv() * Rotation.from_rotvec(after[:, 3:]) * Rotation.from_rotvec(increment[:, 3:]).inv()
    error = rest.as_rotvec()
    residual = np.hstack([np.einsum("nij,nj->ni", back, way) - increment[:, :3], error])
    by = np.zeros((len(before), 6, 12))
    by[:, :3, :3], by[:, :3, 6:9] = -back, back
    by[:, :3, 3:6] = back @ _crosses(way)
    by[:, 3:, 9:] = _inverse_left_jacobians(error) @ back
    by[:, 3:, 3:6] = -by[:, 3:, 9:]
    return np.einsum("nij,nj->ni", root, residual), root @ by


def seen(pose: Floats, point: Floats, observation: ObservationConfig, z: Floats, root: Floats) -> tuple[Floats, Floats]:
    """Residuals (m, c) of readings (m, c) and their derivatives (m, c, 9) by a pose's error (m, 6) and point (m, 3)."""
    model, sensor = MODELS[observation.model], sensor_of(SOLID, observation)
    back, way = Rotation.from_rotvec(pose[:, 3:]).inv().as_matrix(), point - pose[:, :3]
    predicted, slope = np.empty(z.shape), np.empty((*z.shape, 3))
    for k, body in enumerate(np.einsum("nij,nj->ni", back, way)):
        predicted[k], slope[k] = reading(SOLID.key, model, sensor, body)
    by = np.concatenate([-back, back @ _crosses(way), back], axis=2)
    return np.einsum("nij,nj->ni", root, predicted - z), root @ slope @ by


def to_body(observation: ObservationConfig, z: Floats) -> Floats:
    """The body-frame points (m, 3) that readings (m, c) show, NaN where they show none.

    What a reading leaves open is the prior's mean.
    """
    model, sensor = MODELS[observation.model], sensor_of(SOLID, observation)
    R = np.eye(z.shape[1])
    points = [shown(SOLID.key, model, sensor, np.ascontiguousarray(row), R)[0] for row in z]
    return np.array(points).reshape(-1, 3)


def composed(pose: Floats, increment: Floats) -> Floats:
    """A pose (6,) moved by an increment (6,) in its frame."""
    return np.array(SOLID.compose(SOLID.as_pose(pose), SOLID.as_pose(increment)))


def to_map(pose: Floats, body: Floats) -> Floats:
    """Points (m, 3) in the bodies of poses (m, 6), in the frame of these."""
    return np.asarray(pose[:, :3] + Rotation.from_rotvec(pose[:, 3:]).apply(body)) if len(pose) else body


def moved_back(poses: Floats, errors: Floats) -> Floats:
    """Poses (n, 6) less errors (n, 6)."""
    turned = Rotation.from_rotvec(-errors[:, 3:]) * Rotation.from_rotvec(poses[:, 3:])
    return np.hstack([poses[:, :3] - errors[:, :3], turned.as_rotvec()])


def _crosses(vectors: Floats) -> Floats:
    """Cross-product matrices (n, 3, 3)."""
    out = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -z, y, -x
    return out - out.transpose(0, 2, 1)


def _inverse_left_jacobians(vectors: Floats) -> Floats:
    """V⁻¹ (n, 3, 3): exp(V⁻¹(r) e + r) = exp(e) exp(r) to first order in e."""
    out = np.empty((len(vectors), 3, 3))
    for k, (x, y, z) in enumerate(vectors.tolist()):
        so3.left_jacobian_inverse(x, y, z, out[k])
    return out
