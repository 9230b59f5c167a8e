"""The factors of joining: what one closed sub-map says of its frame, its exit and shared landmarks.

A factor predicts the sub-map's local quantities from the global ones, (T_k, T_exit, L_i) ->
(T_k^-1 T_exit, T_k^-1 L_i), and takes xi of the prediction against the estimate in the filter's own
error: on the right-invariant one xi_theta = theta - theta^, xi_i = V(xi_theta)^-1 (l - R(xi_theta) l^),
on the standard one l - l^. Its cost is xi^T P^-1 xi with P the estimate's covariance; landmarks that
no other sub-map holds are dropped from P, which marginalises them exactly.

Global variables are poses (x m, y m, theta rad), then landmarks (x m, y m); increments are additive.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.errors import NumericalError
from submaps.geometry.trig import sincos, wrap
from submaps.submap import Submap

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@jit()
def cholesky(A: Floats) -> bool:
    """Lower Cholesky factor of A (d, d) in place (the upper triangle is left); false at a bad pivot."""
    d = A.shape[0]
    for i in range(d):
        for j in range(i + 1):
            total = A[i, j]
            for k in range(j):
                total -= A[i, k] * A[j, k]
            if i == j:
                if not (total > 0.0 and total < math.inf):
                    return False
                A[i, i] = math.sqrt(total)
            else:
                A[i, j] = total / A[j, j]
    return True


@jit("boolean(float64[:, ::1], float64[:, ::1])")
def information(P: Floats, out: Floats) -> bool:
    """out <- P^-1 by way of the Cholesky factor; destroys P; false where P is not positive definite."""
    d = P.shape[0]
    if not cholesky(P):
        return False
    W = np.zeros((d, d))  # L^-1, row by row
    for i in range(d):
        for k in range(i):
            lik = P[i, k]
            for j in range(k + 1):
                W[i, j] -= lik * W[k, j]
        W[i, i] = 1.0
        for j in range(i + 1):
            W[i, j] /= P[i, i]
    out[:] = 0.0
    for k in range(d):
        for i in range(k + 1):
            wki = W[k, i]
            for j in range(k + 1):
                out[i, j] += wki * W[k, j]
    return True


@jit()
def _inverse_series(phi: float) -> tuple[float, float]:
    """alpha = (phi/2) cot(phi/2), with V(phi)^-1 = [[alpha, phi/2], [-phi/2, alpha]], and its slope."""
    if abs(phi) < 0.3:
        z = phi * phi
        alpha = 1.0 - z / 12.0 * (1.0 + z / 60.0 * (1.0 + z / 42.0 * (1.0 + z / 40.0)))
        slope = -phi / 6.0 * (1.0 + z / 30.0 * (1.0 + z / 28.0 * (1.0 + z / 30.0)))
        return alpha, slope
    s, c = sincos(0.5 * phi)
    return 0.5 * phi * c / s, 0.5 * c / s - 0.25 * phi / (s * s)


@jit("void(boolean, float64[::1], float64[::1], float64[::1], float64[:, ::1], float64[::1], float64[:, ::1])")
def residual(
    invariant: bool, estimate: Floats, frame: Floats, end: Floats, points: Floats, xi: Floats, J: Floats
) -> None:
    """xi (d,) of the prediction against the estimate, and its Jacobian J.

    ``estimate`` (d,) is local: exit pose (3), landmarks (2 each). ``frame``, ``end`` are the global
    poses (3,), ``points`` (s, 2) the global landmarks. J (d, 8) holds, row by row, d/d(frame) (3),
    d/d(end) (3) and d/d(own landmark) (2): a landmark's rows depend on no other landmark.
    """
    s, c = sincos(frame[2])
    phi = wrap(end[2] - frame[2] - estimate[2])
    J[:] = 0.0
    xi[2] = phi
    J[2, 2], J[2, 5] = -1.0, 1.0
    alpha, slope, half = 1.0, 0.0, 0.0
    sp, cp = 0.0, 1.0
    if invariant:
        alpha, slope = _inverse_series(phi)
        half = 0.5 * phi
        sp, cp = sincos(phi)
    row = 0
    for i in range(points.shape[0] + 1):
        gx = end[0] if i == 0 else points[i - 1, 0]
        gy = end[1] if i == 0 else points[i - 1, 1]
        dx, dy = gx - frame[0], gy - frame[1]
        lx, ly = c * dx + s * dy, -s * dx + c * dy
        ex, ey = estimate[row], estimate[row + 1]
        rx, ry = (cp * ex - sp * ey, sp * ex + cp * ey) if invariant else (ex, ey)
        vx, vy = lx - rx, ly - ry
        xi[row] = alpha * vx + half * vy
        xi[row + 1] = -half * vx + alpha * vy
        # d(xi)/d(l): V^-1; by phi: V^-1' v - V^-1 R J l^
        a00, a01, a10, a11 = alpha * c - half * s, alpha * s + half * c, -half * c - alpha * s, -half * s + alpha * c
        column = 3 if i == 0 else 6
        J[row, column], J[row, column + 1], J[row + 1, column], J[row + 1, column + 1] = a00, a01, a10, a11
        J[row, 0], J[row, 1], J[row + 1, 0], J[row + 1, 1] = -a00, -a01, -a10, -a11
        p0, p1 = 0.0, 0.0
        if invariant:
            p0 = slope * vx + 0.5 * vy + alpha * ry - half * rx
            p1 = -0.5 * vx + slope * vy - half * ry - alpha * rx
        # d(l)/d(theta_k) = -J l = (l_y, -l_x)
        J[row, 2] = alpha * ly - half * lx - p0
        J[row + 1, 2] = -half * ly - alpha * lx - p1
        J[row, 5] += p0
        J[row + 1, 5] += p1
        row += 3 if i == 0 else 2


@jit("float64(float64[:, ::1], float64[::1], float64[:, ::1], float64[:, ::1], float64[::1])")
def normal_equations(information: Floats, xi: Floats, J: Floats, H: Floats, g: Floats) -> float:
    """Gauss-Newton block H = J^T P^-1 J and gradient g = J^T P^-1 xi; returns the cost xi^T P^-1 xi.

    H (6 + 2s, 6 + 2s), g (6 + 2s,) in the order frame, end, landmarks. Only H's lower triangle
    counts. Uses that each landmark's rows of J reach frame, end and that landmark alone.
    """
    d = xi.shape[0]
    weighted = np.empty((d, 6))  # P^-1 times J's six pose columns
    y = np.empty(d)
    cost = 0.0
    for i in range(d):
        total = 0.0
        w0 = w1 = w2 = w3 = w4 = w5 = 0.0
        for k in range(d):
            p = information[i, k]
            total += p * xi[k]
            w0 += p * J[k, 0]
            w1 += p * J[k, 1]
            w2 += p * J[k, 2]
            w3 += p * J[k, 3]
            w4 += p * J[k, 4]
            w5 += p * J[k, 5]
        y[i] = total
        weighted[i, 0], weighted[i, 1], weighted[i, 2] = w0, w1, w2
        weighted[i, 3], weighted[i, 4], weighted[i, 5] = w3, w4, w5
        cost += total * xi[i]
    for a in range(6):
        total = 0.0
        for k in range(d):
            total += J[k, a] * y[k]
        g[a] = total
        for b in range(a + 1):
            total = 0.0
            for k in range(d):
                total += J[k, a] * weighted[k, b]
            H[a, b] = total
    for i in range(3, d, 2):
        a00, a01, a10, a11 = J[i, 6], J[i, 7], J[i + 1, 6], J[i + 1, 7]
        r = i + 3
        g[r] = a00 * y[i] + a10 * y[i + 1]
        g[r + 1] = a01 * y[i] + a11 * y[i + 1]
        for b in range(6):
            H[r, b] = a00 * weighted[i, b] + a10 * weighted[i + 1, b]
            H[r + 1, b] = a01 * weighted[i, b] + a11 * weighted[i + 1, b]
        for k in range(3, i + 1, 2):
            t00 = a00 * information[i, k] + a10 * information[i + 1, k]
            t01 = a00 * information[i, k + 1] + a10 * information[i + 1, k + 1]
            t10 = a01 * information[i, k] + a11 * information[i + 1, k]
            t11 = a01 * information[i, k + 1] + a11 * information[i + 1, k + 1]
            q = k + 3
            b00, b01, b10, b11 = J[k, 6], J[k, 7], J[k + 1, 6], J[k + 1, 7]
            H[r, q], H[r, q + 1] = t00 * b00 + t01 * b10, t00 * b01 + t01 * b11
            H[r + 1, q], H[r + 1, q + 1] = t10 * b00 + t11 * b10, t10 * b01 + t11 * b11
    return cost


def rows_of(submap: Submap, landmarks: list[int]) -> Ints:
    """Entries of a sub-map's state for its pose and the named landmarks."""
    slot = submap.slots()
    rows = np.empty(3 + 2 * len(landmarks), dtype=np.int64)
    rows[:3] = (0, 1, 2)
    rows[3::2] = [slot[i] for i in landmarks]
    rows[4::2] = rows[3::2] + 1
    return rows


def factor(submap: Submap, rows: Ints) -> tuple[Floats, Floats]:
    """Estimate (d,) and information (d, d) of a sub-map's state entries ``rows``.

    Raises ``NumericalError`` where the covariance is not positive definite.
    """
    out = np.empty((rows.shape[0], rows.shape[0]))
    if not information(submap.covariance(rows), out):
        raise NumericalError(f"submap {submap.number}: its covariance is not positive definite")
    return submap.mean[rows], out
