"""Marginalising a pose: the map stays as it is, the pose starts anew with a prior of its own.

The prior is independent of the landmarks' *additive* errors. The right-invariant error of a landmark is
e_l - turn(l) e_theta, so there a new rotation correlates with every landmark: forgetting in those coordinates
themselves would make the map as uncertain as the new rotation.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit

Floats = NDArray[np.float64]


@jit()
def _turn_rows(x: Floats, P: Floats, first: int, n: int, sign: float) -> None:
    """P <- D P D^T with D = I plus sign turn(point) in the rotation's columns, for points from ``first`` on."""
    k = first
    while k < n:
        a, b, c = sign * x[k], sign * x[k + 1], sign * x[k + 2]
        for j in range(n):
            P[k, j] += c * P[4, j] - b * P[5, j]
            P[k + 1, j] += a * P[5, j] - c * P[3, j]
            P[k + 2, j] += b * P[3, j] - a * P[4, j]
        k += 6 if k == 0 else 3
    k = first
    while k < n:
        a, b, c = sign * x[k], sign * x[k + 1], sign * x[k + 2]
        for j in range(n):
            P[j, k] += c * P[j, 4] - b * P[j, 5]
            P[j, k + 1] += a * P[j, 5] - c * P[j, 3]
            P[j, k + 2] += b * P[j, 3] - a * P[j, 4]
        k += 6 if k == 0 else 3


@jit()
def replace_pose_additive(x: Floats, P: Floats, n: int, invariant: bool, prior: Floats) -> None:
    """Give the pose in space a covariance of additive errors ``prior`` (6, 6), independent of the landmarks'.

    x holds the new pose. P comes as that of the filter's error and is left that of the additive errors.
    """
    if invariant:
        _turn_rows(x, P, 6, n, 1.0)  # e_l = xi_l + turn(l) xi_theta
    for i in range(6):
        for j in range(n):
            P[i, j] = 0.0
            P[j, i] = 0.0
    P[:6, :6] = prior
    for i in range(n):
        for j in range(i):
            P[j, i] = P[i, j]


@jit()
def replace_pose(x: Floats, P: Floats, n: int, invariant: bool, prior: Floats) -> None:
    """The same, P left that of the filter's error, equal to its transpose."""
    replace_pose_additive(x, P, n, invariant, prior)
    if invariant:
        _turn_rows(x, P, 0, n, -1.0)
    for i in range(n):
        for j in range(i):
            P[j, i] = P[i, j]
