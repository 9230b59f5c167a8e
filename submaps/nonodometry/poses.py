"""Many poses at once, in NumPy: rotation matrices and positions with any leading axes.

A tangent is (position, rotation) along the axes of the frame that the pose is given in:
p = p̂ + ξ_p, R = exp(ξ_θ) R̂, so a covariance of it is of additive position and of a rotation vector
about those axes (Sola, Deray, Atchuthan, "A micro Lie theory", 2018, section II-E, left).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_NEAR = 1e-4  # rad; below it series serve, their next terms below 1e-16
# S(v) as a row of nine is v times this.
_GENERATORS = np.array(
    [[0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0], [0, -1, 0, 1, 0, 0, 0, 0, 0]], float
)


@dataclass(frozen=True)
class Poses:
    """Rotations (..., 3, 3) and positions (..., 3) m: each takes coordinates of a body to the map."""

    rotation: Floats
    position: Floats

    def take(self, index: NDArray[np.int64] | NDArray[np.bool_] | int) -> Poses:
        """Those along the first axis that ``index`` names."""
        return Poses(self.rotation[index], self.position[index])

    def repeat(self, count: int) -> Poses:
        """``count`` of one pose, along a new first axis."""
        rotation = np.broadcast_to(self.rotation, (count, *self.rotation.shape))
        return Poses(rotation, np.broadcast_to(self.position, (count, *self.position.shape)))

    def to_body(self, points: Floats) -> Floats:
        """y = Rᵀ(m − p) (..., 3, n) of points m (..., n, 3): coordinates before points, as sensors take them."""
        arm = points - self.position[..., np.newaxis, :]
        return np.asarray(np.swapaxes(self.rotation, -1, -2) @ np.swapaxes(arm, -1, -2))

    def retract(self, xi: Floats) -> Poses:
        """The poses at tangents (..., 6) from these."""
        return Poses(exp(xi[..., 3:]) @ self.rotation, self.position + xi[..., :3])

    def minus(self, mean: Poses) -> Floats:
        """Tangents (..., 6) from ``mean`` to these: ``mean.retract(poses.minus(mean))`` gives these back."""
        turn = self.rotation @ np.swapaxes(mean.rotation, -1, -2)
        return np.concatenate([self.position - mean.position, log(turn)], axis=-1)


def stack(poses: list[Poses]) -> Poses:
    """Poses along a new first axis."""
    return Poses(np.stack([one.rotation for one in poses]), np.stack([one.position for one in poses]))


def exp(theta: Floats) -> Floats:
    """Rotations of vectors (..., 3) rad: I + sin φ/φ S + (1 − cos φ)/φ² S² (Sola et al., eq. 134)."""
    cross = (theta @ _GENERATORS).reshape(*theta.shape, 3)
    squared = np.einsum("...i,...i->...", theta, theta)[..., np.newaxis, np.newaxis]
    angle = np.sqrt(np.maximum(squared, _NEAR**2))
    half = np.sin(0.5 * angle) / angle
    near = squared < _NEAR**2
    first = np.where(near, 1.0 - squared / 6.0, np.sin(angle) / angle)
    second = np.where(near, 0.5 - squared / 24.0, 2.0 * half * half)
    return np.asarray(np.eye(3) + (first * np.eye(3) + second * cross) @ cross)


def log(rotation: Floats) -> Floats:
    """Rotation vectors (..., 3) rad of rotations by less than π (Sola et al., eq. 133)."""
    axis = np.empty(rotation.shape[:-1])
    axis[..., 0] = 0.5 * (rotation[..., 2, 1] - rotation[..., 1, 2])
    axis[..., 1] = 0.5 * (rotation[..., 0, 2] - rotation[..., 2, 0])
    axis[..., 2] = 0.5 * (rotation[..., 1, 0] - rotation[..., 0, 1])
    sine = np.sqrt(np.sum(axis * axis, axis=-1))
    cosine = 0.5 * (rotation[..., 0, 0] + rotation[..., 1, 1] + rotation[..., 2, 2] - 1.0)
    near = (sine < _NEAR) & (cosine > 0.0)
    scale = np.where(near, 1.0 + sine**2 / 6.0, np.arctan2(sine, cosine) / np.where(sine > 0.0, sine, 1.0))
    return np.asarray(scale[..., np.newaxis] * axis)
