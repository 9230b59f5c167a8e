"""When a sub-map ends and the next begins."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.filtering.layout import (
    DIM,
    INVARIANT,
    MAX_HEADING_VARIANCE,
    MAX_LANDMARKS,
    MAX_POSITION_VARIANCE,
    MIN_OBSERVED,
    MOTIONLESS,
    OBSERVED,
)
from submaps.filtering.predicting import pending_of, rotate_noise
from submaps.geometry import so3
from submaps.geometry.space import Key
from submaps.geometry.trig import arctan2, sincos

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@jit()
def wants_genesis(
    space: Key, new: int, x: Floats, P: Floats, counts: Ints, motion: Floats, whole: Ints, real: Floats
) -> bool:
    """Whether the sub-map ends before a step whose observations bring ``new`` landmarks to it."""
    held = int(counts[DIM] - (3 * len(space) - 3)) // len(space)
    if held == 0 and counts[OBSERVED] == 0:
        return False
    full = new > 0 and held + new > int(whole[MAX_LANDMARKS])
    pending, noise = pending_of(space, motion)
    if whole[MOTIONLESS] != 0:
        return full  # each pose is found anew: none grows less certain in the sub-map's frame
    if not np.any(pending):
        # A robot that stands still begins no sub-map, but a state must stay bounded.
        return new > 0 and held + new > 2 * int(whole[MAX_LANDMARKS])
    if full or counts[OBSERVED] < whole[MIN_OBSERVED]:
        return full
    invariant = whole[INVARIANT] != 0
    if len(space) == 2:
        heading = float(P[2, 2] + noise[2, 2])
        position = _variance_in_plane(x, P, pending, noise, invariant)
    else:
        heading, position = _variances_in_space(x, P, pending, noise, invariant)
    return heading > float(real[MAX_HEADING_VARIANCE]) or position > float(real[MAX_POSITION_VARIANCE])


@jit()
def _variance_in_plane(x: Floats, P: Floats, pending: Floats, noise: Floats, invariant: bool) -> float:
    """Trace of the covariance (m^2) of the position's additive error, the pending increment taken in.

    The error is xi_p + J q xi_theta plus the increment's own, with q the position after it on the
    invariant error and the increment itself, R d, on the standard one.
    """
    s, c = sincos(x[2])
    q0 = c * pending[0] - s * pending[1] + (x[0] if invariant else 0.0)
    q1 = s * pending[0] + c * pending[1] + (x[1] if invariant else 0.0)
    own: float = P[0, 0] + P[1, 1] + noise[0, 0] + noise[1, 1]
    own += 2.0 * (q0 * P[1, 2] - q1 * P[0, 2]) + (q0 * q0 + q1 * q1) * P[2, 2]
    return own


@jit()
def _variances_in_space(x: Floats, P: Floats, pending: Floats, noise: Floats, invariant: bool) -> tuple[float, float]:
    """The same in space, after the rotation's largest variance in any direction (rad^2)."""
    R, turned, S, q = np.empty((3, 3)), np.empty((6, 6)), np.empty((3, 3)), np.empty(3)
    so3.matrix(x[3], x[4], x[5], R)
    rotate_noise(R, noise, turned)
    position = noise[0, 0] + noise[1, 1] + noise[2, 2]
    for i in range(3):
        q[i] = x[i] if invariant else 0.0
        position += P[i, i]
        for j in range(3):
            q[i] += R[i, j] * pending[j]
            S[i, j] = P[3 + i, 3 + j] + turned[3 + i, 3 + j]
    # tr(turn(q) P_theta,p) = sum of q_i times the antisymmetric part, tr(turn T turn^T) = |q|^2 tr T - q^T T q
    squared, turning = q[0] * q[0] + q[1] * q[1] + q[2] * q[2], 0.0
    for i in range(3):
        one, two = (i + 1) % 3, (i + 2) % 3
        position += 2.0 * q[i] * (P[one, 3 + two] - P[two, 3 + one])
        turning += squared * P[3 + i, 3 + i]
        for j in range(3):
            turning -= q[i] * P[3 + i, 3 + j] * q[j]
    return _largest_eigenvalue(S), float(position + turning)


@jit()
def _largest_eigenvalue(S: Floats) -> float:
    """Of a symmetric (3, 3) matrix, in closed form (Smith, Comm. ACM 4(4), 1961)."""
    mean = (S[0, 0] + S[1, 1] + S[2, 2]) / 3.0
    off = S[0, 1] * S[0, 1] + S[0, 2] * S[0, 2] + S[1, 2] * S[1, 2]
    a, b, c = S[0, 0] - mean, S[1, 1] - mean, S[2, 2] - mean
    spread = math.sqrt((a * a + b * b + c * c + 2.0 * off) / 6.0)
    if not spread > 0.0:
        return float(mean)
    minors = a * (b * c - S[1, 2] * S[1, 2]) - S[0, 1] * (S[0, 1] * c - S[1, 2] * S[0, 2])
    determinant = (minors + S[0, 2] * (S[0, 1] * S[1, 2] - b * S[0, 2])) / (spread * spread * spread)
    half = min(max(0.5 * determinant, -1.0), 1.0)
    third = arctan2(math.sqrt(1.0 - half * half), half) / 3.0
    return float(mean + 2.0 * spread * sincos(third)[1])
