"""A pose from what is seen alone: maximum likelihood, where nothing is known of the motion.

The pose has a flat prior (Klecka, "Comparison of different approaches to adaptation of unscented Kalman filter
for non-odometry SLAM", eqs. 13, 14 and 21): the old one is marginalised, the new one is found from the readings
of known landmarks, closed form first (Horn, J. Opt. Soc. Am. A 4(4), 1987), then Gauss-Newton, each reading as
uncertain as it and its landmark are. It enters the
filter with a covariance so much wider than what those readings say that nothing counts twice.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.filtering.forgetting import replace_pose
from submaps.filtering.kernel import linearise
from submaps.filtering.layout import SENSOR
from submaps.filtering.workspace import GAIN, INNOVATION, NOISE, POINT, TURNING
from submaps.geometry import so3
from submaps.geometry.space import Key
from submaps.observation.models import invert

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Variance of the pose's prior over that of what the readings say of it.
_WIDER = 1e6
_ITERATIONS, _SWEEPS, _SETTLED = 20, 12, 1e-12
LEAST_KNOWN = 3
# Share of the information in some direction below which points count as collinear.
_LEAST_SHARE = 1e-10

_quaternion, _multiply, _rotation_vector = so3.quaternion, so3.multiply, so3.rotation_vector
_entries = so3.entries


@jit()
def relocalise(
    space: Key, x: Floats, P: Floats, n: int, invariant: bool, begin: int, end: int, landmark: Ints, z: Floats,
    R: Floats, model: int, real: Floats, slot_of: NDArray[np.int32], w: Floats,
) -> bool:  # fmt: skip
    """Put the pose where one step's readings of known landmarks say, with a wide prior; false where they do not.

    On success x and the pose's rows and columns of P are changed, otherwise nothing is.
    """
    pose = np.empty(6)
    if not _closed_form(space, x, begin, end, landmark, z, R, model, real, slot_of, w, pose):
        return False
    state = np.concatenate((pose, np.zeros(3)))
    information, gradient, L = np.empty((6, 6)), np.empty(6), np.empty((6, 6))
    for _ in range(_ITERATIONS):
        information[:] = 0.0
        gradient[:] = 0.0
        for o in range(begin, end):
            slot = slot_of[landmark[o]]
            if slot >= 0:
                state[6:9] = x[slot : slot + 3]
                linearise(space, state, 6, model, real, SENSOR, z[:, o], 0, R[o if R.shape[0] > 1 else 0], w)
                _add_landmark_noise(x, P, slot, invariant, w)
                _accumulate(w, information, gradient)
        if not _factor(information, L):
            return False
        _solve(L, gradient)
        size = _move(state, gradient)
        if not size < math.inf:
            return False
        if size < _SETTLED:
            break
    x[:6] = state[:6]
    _wide_prior(L, information)
    replace_pose(x, P, n, invariant, information)
    return True


@jit()
def _add_landmark_noise(x: Floats, P: Floats, k: int, invariant: bool, w: Floats) -> None:
    """Add G C G^T to the reading's noise, C (3, 3) of the landmark's additive error, e_l = xi_l + turn(l) xi_theta.

    A map that is not yet certain would else bend the pose to fit it.
    """
    C, D = np.empty((3, 3)), np.zeros((3, 6))
    for i in range(3):
        D[i, i] = 1.0
        one, two = (i + 1) % 3, (i + 2) % 3
        if invariant:
            D[i, 3 + one], D[i, 3 + two] = x[k + two], -x[k + one]
    for i in range(3):
        for j in range(3):
            total = 0.0
            for a in range(6):
                for b in range(6):
                    total += D[i, a] * P[k + a if a < 3 else a, k + b if b < 3 else b] * D[j, b]
            C[i, j] = total
    for i in range(3):
        for j in range(3):
            total = w[NOISE + 3 * i + j]
            for a in range(3):
                for b in range(3):
                    total += w[GAIN + 3 * i + a] * C[a, b] * w[GAIN + 3 * j + b]
            w[NOISE + 3 * i + j] = total


@jit()
def _accumulate(w: Floats, information: Floats, gradient: Floats) -> None:
    """Add one reading's H^T R^-1 H and H^T R^-1 v, H = (-gain, turning) on (position, rotation), in place."""
    H, column, N = np.empty((3, 6)), np.empty(3), np.empty((3, 3))
    for a in range(3):
        for j in range(3):
            N[a, j] = w[NOISE + 3 * a + j]
            H[a, j] = -w[GAIN + 3 * a + j]
            H[a, 3 + j] = w[TURNING + 3 * a + j]
    for i in range(3):  # whiten rows of H and v by the Cholesky factor of the noise
        for j in range(i + 1):
            total = N[i, j]
            for k in range(j):
                total -= N[i, k] * N[j, k]
            N[i, j] = math.sqrt(total) if i == j else total / N[j, j]
        column[i] = w[INNOVATION + i]
        for k in range(i):
            column[i] -= N[i, k] * column[k]
            for j in range(6):
                H[i, j] -= N[i, k] * H[k, j]
        column[i] /= N[i, i]
        for j in range(6):
            H[i, j] /= N[i, i]
    for i in range(6):
        for a in range(3):
            gradient[i] += H[a, i] * column[a]
            for j in range(6):
                information[i, j] += H[a, i] * H[a, j]


@jit()
def _factor(A: Floats, L: Floats) -> bool:
    """Cholesky factor of A (6, 6) into L; false where a pivot says that some direction is not seen."""
    for i in range(6):
        for j in range(i + 1):
            total = A[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i == j:
                if not (total > _LEAST_SHARE * A[i, i] and total < math.inf):
                    return False
                L[i, i] = math.sqrt(total)
            else:
                L[i, j] = total / L[j, j]
    return True


@jit()
def _solve(L: Floats, b: Floats) -> None:
    """b <- (L L^T)^-1 b."""
    for i in range(6):
        for k in range(i):
            b[i] -= L[i, k] * b[k]
        b[i] /= L[i, i]
    for i in range(5, -1, -1):
        for k in range(i + 1, 6):
            b[i] -= L[k, i] * b[k]
        b[i] /= L[i, i]


@jit()
def _move(state: Floats, step: Floats) -> float:
    """p <- p + step_p, R <- exp(step_theta) R; the squared size of the step."""
    size = 0.0
    for i in range(6):
        size += step[i] * step[i]
    for i in range(3):
        state[i] += step[i]
    q = _multiply(_quaternion(step[3], step[4], step[5]), _quaternion(state[3], state[4], state[5]))
    state[3], state[4], state[5] = _rotation_vector(q)
    return size


@jit()
def _wide_prior(L: Floats, out: Floats) -> None:
    """out <- (L L^T)^-1 (6, 6), many times over."""
    unit = np.empty(6)
    for j in range(6):
        unit[:] = 0.0
        unit[j] = _WIDER
        _solve(L, unit)
        for i in range(j, 6):
            out[i, j] = unit[i]
            out[j, i] = unit[i]


@jit()
def _closed_form(
    space: Key, x: Floats, begin: int, end: int, landmark: Ints, z: Floats, R: Floats, model: int, real: Floats,
    slot_of: NDArray[np.int32], w: Floats, pose: Floats,
) -> bool:  # fmt: skip
    """The pose that lays the points that readings show onto the landmarks: l = p + R y in least squares."""
    body, mean, known = np.zeros(3), np.zeros(3), 0
    for o in range(begin, end):
        slot = slot_of[landmark[o]]
        if slot >= 0:
            invert(space, model, real, SENSOR, z[:, o], 0, R[o if R.shape[0] > 1 else 0], w)
            if not _is_finite(w):
                continue
            known += 1
            for i in range(3):
                body[i] += w[POINT + i]
                mean[i] += x[slot + i]
    if known < LEAST_KNOWN:
        return False
    body /= known
    mean /= known
    M = np.zeros((3, 3))
    for o in range(begin, end):
        slot = slot_of[landmark[o]]
        if slot >= 0:
            invert(space, model, real, SENSOR, z[:, o], 0, R[o if R.shape[0] > 1 else 0], w)
            if not _is_finite(w):
                continue
            for i in range(3):
                for j in range(3):
                    M[i, j] += (w[POINT + i] - body[i]) * (x[slot + j] - mean[j])
    q = _rotation_of(M)
    r = _rotation_vector(q)
    turned = _entries(r[0], r[1], r[2])
    for i in range(3):
        pose[3 + i] = r[i]
        pose[i] = mean[i]
        for j in range(3):
            pose[i] -= turned[3 * i + j] * body[j]
    return True


@jit()
def _is_finite(w: Floats) -> bool:
    """Whether the point that a reading shows is one."""
    return bool(abs(w[POINT]) + abs(w[POINT + 1]) + abs(w[POINT + 2]) < math.inf)


@jit()
def _rotation_of(M: Floats) -> so3.Quaternion:
    """The quaternion of largest q^T N q, N made of M = sum of y l^T as in Horn's paper, by Jacobi rotations."""
    N, V = np.empty((4, 4)), np.eye(4)  # order (w, x, y, z)
    N[0, 0] = M[0, 0] + M[1, 1] + M[2, 2]
    N[1, 1] = M[0, 0] - M[1, 1] - M[2, 2]
    N[2, 2] = -M[0, 0] + M[1, 1] - M[2, 2]
    N[3, 3] = -M[0, 0] - M[1, 1] + M[2, 2]
    N[0, 1], N[0, 2], N[0, 3] = M[1, 2] - M[2, 1], M[2, 0] - M[0, 2], M[0, 1] - M[1, 0]
    N[1, 2], N[1, 3], N[2, 3] = M[0, 1] + M[1, 0], M[2, 0] + M[0, 2], M[1, 2] + M[2, 1]
    for i in range(4):
        for j in range(i):
            N[i, j] = N[j, i]
    for _ in range(_SWEEPS):
        for p in range(3):
            for q in range(p + 1, 4):
                _rotate(N, V, p, q)
    best = 0
    for i in range(1, 4):
        if N[i, i] > N[best, best]:
            best = i
    return V[1, best], V[2, best], V[3, best], V[0, best]


@jit()
def _rotate(N: Floats, V: Floats, p: int, q: int) -> None:
    """One Jacobi rotation that makes N[p, q] zero (Golub & Van Loan, section 8.5)."""
    if N[p, q] == 0.0:
        return
    tau = (N[q, q] - N[p, p]) / (2.0 * N[p, q])
    t = (1.0 if tau >= 0.0 else -1.0) / (abs(tau) + math.sqrt(1.0 + tau * tau))
    c = 1.0 / math.sqrt(1.0 + t * t)
    s = t * c
    for k in range(4):
        a, b = N[k, p], N[k, q]
        N[k, p], N[k, q] = c * a - s * b, s * a + c * b
    for k in range(4):
        a, b = N[p, k], N[q, k]
        N[p, k], N[q, k] = c * a - s * b, s * a + c * b
    for k in range(4):
        a, b = V[k, p], V[k, q]
        V[k, p], V[k, q] = c * a - s * b, s * a + c * b
