"""Rigid alignment of two sets of points in the plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Alignment:
    """The motion (x m, y m, theta rad) that takes the first points onto the second, and what is left.

    ``rmse`` (m) is the root mean square distance after the motion, ``rmse_before`` without it.
    """

    x: float
    y: float
    theta: float
    rmse: float
    rmse_before: float

    def apply(self, points: Floats) -> Floats:
        """The points (n, 2), moved."""
        c, s = np.cos(self.theta), np.sin(self.theta)
        moved: Floats = points @ np.array([[c, s], [-s, c]]) + (self.x, self.y)
        return moved


def align(a: Floats, b: Floats) -> Alignment:
    """Rotation and translation that minimise Σ‖R aᵢ + t − bᵢ‖², in closed form.

    theta = atan2(Σ aᵢ × bᵢ, Σ aᵢ · bᵢ) of the centred points, t = b̄ − R ā (Umeyama, PAMI 13(4)
    1991, without scale). ``a`` and ``b`` are (n, 2), n at least 1, row by row the same points.
    """
    if a.shape != b.shape or a.ndim != 2 or a.shape[1] != 2 or a.shape[0] == 0:
        raise ValueError(f"expected two arrays of shape (n, 2), n at least 1, got {a.shape} and {b.shape}")
    centre_a, centre_b = a.mean(axis=0), b.mean(axis=0)
    u, v = a - centre_a, b - centre_b
    cross = float(np.sum(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]))
    theta = float(np.arctan2(cross, float(np.sum(u * v))))
    turned = Alignment(0.0, 0.0, theta, 0.0, 0.0)
    x, y = centre_b - turned.apply(centre_a[None])[0]
    left = turned.apply(a) + (x, y) - b
    return Alignment(float(x), float(y), theta, _rms(left), _rms(a - b))


def _rms(difference: Floats) -> float:
    return float(np.sqrt(np.mean(np.sum(difference**2, axis=1))))
