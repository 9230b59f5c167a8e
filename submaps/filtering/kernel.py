"""The filter's equations on one sub-map's arrays: predict, update, augment; compiled.

The state is x = (p_x, p_y, theta, l_1x, l_1y, ...), its covariance the leading (n, n) block of P,
kept whole and equal to its transpose bit for bit. With the right-invariant error (Barrau &
Bonnabel, arXiv:1510.06263) P is that of xi = (xi_p, xi_theta, xi_1, ...), with
p = R(xi_theta) p^ + V(xi_theta) xi_p and alike for each l_i; with the standard error it is that of
the additive errors. J = [[0, -1], [1, 0]].

A prediction is one symmetric rank-one term u u^T plus a change of the pose block, so that it can
ride on the pass over P which the next update makes anyway.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.geometry.trig import EPSILON, rotation_series, sincos, wrap
from submaps.observation.models import innovation, invert, predict

Floats = NDArray[np.float64]

USED, GATED, FLAGGED, SINGULAR, LATE, FIRST = 0, 1, 2, 3, 4, 5
# A pass over P rounds entry (i, j) by some ulps of sqrt(P_ii P_jj); this much of the diagonal,
# times n, is given back so that P stays positive definite. It loses information, invents none.
_ROUNDING = 16.0 * EPSILON


@jit()
def accumulate(pending: Floats, noise: Floats, step: Floats, step_noise: Floats) -> None:
    """Compose one body-frame increment onto the pending one, both (3,) with covariance (3, 3).

    D <- D + (R(D_theta) v, w); the error of the composition is
    d(D) + (J R(D_theta) v, 0) d(D_theta) + diag(R(D_theta), 1) d(step). To first order this equals
    predicting with each increment in turn.
    """
    s, c = sincos(pending[2])
    v0 = c * step[0] - s * step[1]
    v1 = s * step[0] + c * step[1]
    n00 = c * c * step_noise[0, 0] - 2.0 * c * s * step_noise[0, 1] + s * s * step_noise[1, 1]
    n01 = c * s * (step_noise[0, 0] - step_noise[1, 1]) + (c * c - s * s) * step_noise[0, 1]
    n11 = s * s * step_noise[0, 0] + 2.0 * c * s * step_noise[0, 1] + c * c * step_noise[1, 1]
    n02 = c * step_noise[0, 2] - s * step_noise[1, 2]
    n12 = s * step_noise[0, 2] + c * step_noise[1, 2]
    heading, q02, q12 = noise[2, 2], noise[0, 2], noise[1, 2]
    noise[0, 0] += -2.0 * v1 * q02 + v1 * v1 * heading + n00
    noise[0, 1] += v0 * q02 - v1 * q12 - v0 * v1 * heading + n01
    noise[1, 1] += 2.0 * v0 * q12 + v0 * v0 * heading + n11
    noise[0, 2] += -v1 * heading + n02
    noise[1, 2] += v0 * heading + n12
    noise[2, 2] += step_noise[2, 2]
    noise[1, 0], noise[2, 0], noise[2, 1] = noise[0, 1], noise[0, 2], noise[1, 2]
    pending[0] += v0
    pending[1] += v1
    pending[2] = wrap(pending[2] + step[2])


@jit()
def predict_invariant(x: Floats, P: Floats, n: int, pending: Floats, noise: Floats, u: Floats) -> bool:
    """Move the pose by the pending increment; leave the covariance's rank-one part in u.

    F = I, G = [[R, -J p+], [0, 1], [0, -J l_i] ...]. With Q = q c c^T + Q_rest (c = Q_theta / q),
    G Q G^T = u u^T + diag(R Q_rest R^T, 0 ...), u = sqrt(q) G c. Returns whether u is non-zero.
    """
    s, c = sincos(x[2])
    x[0] += c * pending[0] - s * pending[1]
    x[1] += s * pending[0] + c * pending[1]
    x[2] = wrap(x[2] + pending[2])
    q = noise[2, 2]
    c0 = noise[0, 2] / q if q > 0.0 else 0.0
    c1 = noise[1, 2] / q if q > 0.0 else 0.0
    q00 = max(noise[0, 0] - q * c0 * c0, 0.0)
    q11 = max(noise[1, 1] - q * c1 * c1, 0.0)
    q01 = noise[0, 1] - q * c0 * c1
    P[0, 0] += c * c * q00 - 2.0 * c * s * q01 + s * s * q11
    P[1, 1] += s * s * q00 + 2.0 * c * s * q01 + c * c * q11
    P[0, 1] += c * s * (q00 - q11) + (c * c - s * s) * q01
    P[1, 0] = P[0, 1]
    if q <= 0.0:
        return False
    root = math.sqrt(q)
    u[0] = root * (c * c0 - s * c1 + x[1])
    u[1] = root * (s * c0 + c * c1 - x[0])
    u[2] = root
    for i in range(3, n, 2):
        u[i] = root * x[i + 1]
        u[i + 1] = -root * x[i]
    return True


@jit()
def predict_standard(x: Floats, P: Floats, n: int, pending: Floats, noise: Floats) -> None:
    """The textbook prediction in O(n): F = [[I, J R d], [0, 1]] on the pose's rows, G = diag(R, 1)."""
    s, c = sincos(x[2])
    d0 = c * pending[0] - s * pending[1]
    d1 = s * pending[0] + c * pending[1]
    x[0] += d0
    x[1] += d1
    x[2] = wrap(x[2] + pending[2])
    for j in range(n):
        P[0, j] -= d1 * P[2, j]
        P[1, j] += d0 * P[2, j]
    for j in range(n):
        P[j, 0] -= d1 * P[j, 2]
        P[j, 1] += d0 * P[j, 2]
    q00, q01, q11 = noise[0, 0], noise[0, 1], noise[1, 1]
    P[0, 0] += c * c * q00 - 2.0 * c * s * q01 + s * s * q11
    P[1, 1] += s * s * q00 + 2.0 * c * s * q01 + c * c * q11
    P[0, 1] += c * s * (q00 - q11) + (c * c - s * s) * q01
    P[0, 2] += c * noise[0, 2] - s * noise[1, 2]
    P[1, 2] += s * noise[0, 2] + c * noise[1, 2]
    P[2, 2] += noise[2, 2]
    P[1, 0] = P[0, 1]
    for j in range(2, n):
        P[j, 0] = P[0, j]
        P[j, 1] = P[1, j]


@jit()
def add_rank_one(P: Floats, n: int, u: Floats) -> None:
    """P <- P + u u^T."""
    for i in range(n):
        ui = u[i]
        for j in range(n):
            P[i, j] += ui * u[j]


# The two passes over P walk two rows at a time over whole cache lines: half the loads of the
# vectors, no remainder loop. P has room to the next multiple of eight; the vectors end in zeros.


@jit()
def _subtract_rank_two(P: Floats, n: int, a: Floats, b: Floats) -> None:
    floor = _ROUNDING * n
    width = (n + 7) // 8 * 8
    for i in range(0, n, 2):
        a0, b0, a1, b1 = a[i], b[i], a[i + 1], b[i + 1]
        for j in range(width):
            aj, bj = a[j], b[j]
            P[i, j] -= a0 * aj + b0 * bj
            P[i + 1, j] -= a1 * aj + b1 * bj
    for i in range(n):
        P[i, i] += floor * (P[i, i] + a[i] * a[i] + b[i] * b[i])


@jit()
def _add_one_subtract_two(P: Floats, n: int, u: Floats, a: Floats, b: Floats) -> None:
    floor = _ROUNDING * n
    width = (n + 7) // 8 * 8
    for i in range(0, n, 2):
        u0, a0, b0, u1, a1, b1 = u[i], a[i], b[i], u[i + 1], a[i + 1], b[i + 1]
        for j in range(width):
            uj, aj, bj = u[j], a[j], b[j]
            P[i, j] += u0 * uj - (a0 * aj + b0 * bj)
            P[i + 1, j] += u1 * uj - (a1 * aj + b1 * bj)
    for i in range(n):
        P[i, i] += floor * (P[i, i] + a[i] * a[i] + b[i] * b[i])


@jit()
def _end_in_zeros(n: int, vector: Floats) -> None:
    for j in range(n, (n + 7) // 8 * 8):
        vector[j] = 0.0


@jit()
def _gain_columns(
    P: Floats, n: int, k: int, g: tuple[float, float, float, float, float, float], u: Floats, has_u: bool,
    a: Floats, b: Floats,
) -> None:  # fmt: skip
    """(a, b) <- (P + u u^T) H^T for H = g (2, 2) on l - p and (g4, g5) on theta."""
    g00, g01, g10, g11, t0, t1 = g
    px, py, heading, lx, ly = P[0], P[1], P[2], P[k], P[k + 1]
    for j in range(n):
        e0 = lx[j] - px[j]
        e1 = ly[j] - py[j]
        a[j] = g00 * e0 + g01 * e1
        b[j] = g10 * e0 + g11 * e1
    if t0 != 0.0 or t1 != 0.0:
        for j in range(n):
            a[j] += t0 * heading[j]
            b[j] += t1 * heading[j]
    if has_u:
        e0, e1 = u[k] - u[0], u[k + 1] - u[1]
        w0 = g00 * e0 + g01 * e1
        w1 = g10 * e0 + g11 * e1
        for j in range(n):
            a[j] += w0 * u[j]
            b[j] += w1 * u[j]


@jit()
def retract(x: Floats, n: int, a: Floats, b: Floats, wa: float, wb: float, invariant: bool) -> None:
    """Apply xi = a wa + b wb: x <- R(xi_theta) x + V(xi_theta) xi for every point, or x + xi."""
    heading = a[2] * wa + b[2] * wb
    if not invariant:
        for j in range(n):
            x[j] += a[j] * wa + b[j] * wb
        x[2] = wrap(x[2])
        return
    s, c = sincos(heading)
    v, w = rotation_series(heading)
    x[2] = wrap(x[2] + heading)
    j = 0
    while j < n:
        d0 = a[j] * wa + b[j] * wb
        d1 = a[j + 1] * wa + b[j + 1] * wb
        x0, x1 = x[j], x[j + 1]
        x[j] = c * x0 - s * x1 + v * d0 - w * d1
        x[j + 1] = s * x0 + c * x1 + w * d0 + v * d1
        j += 3 if j == 0 else 2


@jit()
def update(
    x: Floats, P: Floats, n: int, k: int, model: int, mount: Floats, z0: float, z1: float, R: Floats,
    gate: float, flag: float, invariant: bool, u: Floats, has_u: bool, a: Floats, b: Floats,
) -> tuple[int, float]:  # fmt: skip
    """One observation of the landmark at x[k:k+2]; returns (status, normalised innovation squared).

    H = dh/dy [-R^T, 0, ..., R^T, ...] on the invariant error, with -R^T J (l - p) in the heading
    column on the standard one; S = H P H^T + R = L L^T; P <- P - A A^T with A = P H^T L^-T.
    Rejected observations (GATED, SINGULAR) leave x and P as they were, with u still to be added.
    """
    s, c = sincos(x[2])
    d0, d1 = x[k] - x[0], x[k + 1] - x[1]
    h0, h1, h00, h01, h10, h11 = predict(model, c * d0 + s * d1, -s * d0 + c * d1, mount)
    v0, v1 = innovation(model, z0, z1, h0, h1)
    g00, g01, g10, g11 = h00 * c - h01 * s, h00 * s + h01 * c, h10 * c - h11 * s, h10 * s + h11 * c
    t0 = 0.0 if invariant else g00 * d1 - g01 * d0
    t1 = 0.0 if invariant else g10 * d1 - g11 * d0
    _gain_columns(P, n, k, (g00, g01, g10, g11, t0, t1), u, has_u, a, b)
    s00 = g00 * (a[k] - a[0]) + g01 * (a[k + 1] - a[1]) + t0 * a[2] + R[0, 0]
    s10 = g10 * (a[k] - a[0]) + g11 * (a[k + 1] - a[1]) + t1 * a[2] + R[1, 0]
    s11 = g10 * (b[k] - b[0]) + g11 * (b[k + 1] - b[1]) + t1 * b[2] + R[1, 1]
    if not (s00 > 0.0 and s00 < math.inf):
        return SINGULAR, math.nan
    l00 = math.sqrt(s00)
    l10 = s10 / l00
    rest = s11 - l10 * l10
    if not (rest > 4.0 * EPSILON * s11 and rest < math.inf):
        return SINGULAR, math.nan
    l11 = math.sqrt(rest)
    w0 = v0 / l00
    w1 = (v1 - l10 * w0) / l11
    nis = w0 * w0 + w1 * w1
    if not nis < math.inf:
        return SINGULAR, math.nan
    if nis > gate:
        return GATED, nis
    for j in range(n):
        a[j] /= l00
        b[j] = (b[j] - l10 * a[j]) / l11
    _end_in_zeros(n, a)
    _end_in_zeros(n, b)
    retract(x, n, a, b, w0, w1, invariant)
    if has_u:
        _end_in_zeros(n, u)
        _add_one_subtract_two(P, n, u, a, b)
    else:
        _subtract_rank_two(P, n, a, b)
    return (FLAGGED if nis > flag else USED), nis


@jit()
def augment(
    x: Floats, P: Floats, n: int, model: int, mount: Floats, z0: float, z1: float, R: Floats, invariant: bool
) -> bool:
    """Append the landmark that a reading shows at x[n:n+2]; false if it is not finite.

    l = p + R y(z). xi_new = xi_p + R w on the invariant error, dp + J R y dtheta + R w on the
    standard one, w the reading's noise carried into the body frame.
    """
    s, c = sincos(x[2])
    y0, y1, j00, j01, j10, j11 = invert(model, z0, z1, mount)
    d0, d1 = c * y0 - s * y1, s * y0 + c * y1
    g00, g01, g10, g11 = c * j00 - s * j10, c * j01 - s * j11, s * j00 + c * j10, s * j01 + c * j11
    w00 = g00 * (g00 * R[0, 0] + g01 * R[1, 0]) + g01 * (g00 * R[0, 1] + g01 * R[1, 1])
    w01 = g10 * (g00 * R[0, 0] + g01 * R[1, 0]) + g11 * (g00 * R[0, 1] + g01 * R[1, 1])
    w11 = g10 * (g10 * R[0, 0] + g11 * R[1, 0]) + g11 * (g10 * R[0, 1] + g11 * R[1, 1])
    if not (abs(d0) + abs(d1) < math.inf and w00 + w11 < math.inf):
        return False
    t0 = 0.0 if invariant else -d1
    t1 = 0.0 if invariant else d0
    for j in range(n):
        P[n, j] = P[0, j] + t0 * P[2, j]
        P[n + 1, j] = P[1, j] + t1 * P[2, j]
    P[n, n] = P[n, 0] + t0 * P[n, 2] + w00
    P[n + 1, n] = P[n + 1, 0] + t0 * P[n + 1, 2] + w01
    P[n + 1, n + 1] = P[n + 1, 1] + t1 * P[n + 1, 2] + w11
    P[n, n + 1] = P[n + 1, n]
    for j in range(n):
        P[j, n] = P[n, j]
        P[j, n + 1] = P[n + 1, j]
    x[n] = x[0] + d0
    x[n + 1] = x[1] + d1
    return True
