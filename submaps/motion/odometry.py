"""Odometry: a control is the body-frame increment itself, in the plane or in space."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.geometry import so3

Floats = NDArray[np.float64]


@jit()
def increment(control: Floats, covariance: Floats, out: Floats, out_covariance: Floats) -> None:
    """Increment (dx m, dy m, dtheta rad) of one reading, with its covariance (3, 3).

    The pose moves by p + R(theta)(dx, dy), theta + dtheta; the noise is additive in the body frame.
    """
    for i in range(3):
        out[i] = control[i]
        for j in range(3):
            out_covariance[i, j] = covariance[i, j]


@jit(
    "void(float64[:], float64[:, :], float64[:], float64[:, :])",
)
def increment_in_space(control: Floats, covariance: Floats, out: Floats, out_covariance: Floats) -> None:
    """Increment (dx, dy, dz m, then a rotation vector, rad) of one reading, with its covariance (6, 6).

    p <- p + R(d + e_d), R <- R exp(r + e_r), the noise of the reading's numbers as they stand. The covariance
    that comes out is of the increment's own error, exp(e) exp(r): e = V(r) e_r, V the left Jacobian.
    """
    V, room = np.empty((3, 3)), np.empty((6, 6))
    so3.left_jacobian(control[3], control[4], control[5], V)
    for i in range(6):
        out[i] = control[i]
        for j in range(6):
            total = covariance[i, j]
            if i >= 3:
                total = 0.0
                for k in range(3):
                    total += V[i - 3, k] * covariance[3 + k, j]
            room[i, j] = total
    for i in range(6):
        for j in range(6):
            total = room[i, j]
            if j >= 3:
                total = 0.0
                for k in range(3):
                    total += room[i, 3 + k] * V[j - 3, k]
            out_covariance[i, j] = total
