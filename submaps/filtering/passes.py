"""The passes over a covariance: where the time goes; compiled for each dimension with loops of known width.

Each walks two rows at a time over whole cache lines: half the loads of the vectors, no remainder loop. P has
room to the next multiple of eight; the vectors end in zeros. P stays equal to its transpose bit for bit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.filtering.workspace import GAIN, INNOVATION_COVARIANCE, TURNING
from submaps.geometry.space import Key
from submaps.geometry.trig import EPSILON

Floats = NDArray[np.float64]

# A pass over P rounds entry (i, j) by some ulps of sqrt(P_ii P_jj); this much of the diagonal,
# times n, is given back so that P stays positive definite. It loses information, invents none.
_ROUNDING = 16.0 * EPSILON


@jit()
def add(space: Key, P: Floats, n: int, U: Floats) -> None:
    """P <- P + U^T U, of the rows of U: one in the plane, three in space."""
    if len(space) == 2:
        u = U[0]
        for i in range(n):
            ui = u[i]
            for j in range(n):
                P[i, j] += ui * u[j]
    else:
        a, b, c = U[0], U[1], U[2]
        for i in range(n):
            ai, bi, ci = a[i], b[i], c[i]
            for j in range(n):
                P[i, j] += ai * a[j] + bi * b[j] + ci * c[j]


@jit(inline=True)
def subtract(space: Key, P: Floats, n: int, A: Floats) -> None:
    """P <- P - A^T A, of the rows of A: two in the plane, three in space."""
    width = (n + 7) // 8 * 8
    end_in_zeros(n, A)
    if len(space) == 2:
        a, b = A[0], A[1]
        for i in range(0, n, 2):
            a0, b0, a1, b1 = a[i], b[i], a[i + 1], b[i + 1]
            for j in range(width):
                aj, bj = a[j], b[j]
                P[i, j] -= a0 * aj + b0 * bj
                P[i + 1, j] -= a1 * aj + b1 * bj
    else:
        a, b, c = A[0], A[1], A[2]
        for i in range(0, n, 2):
            a0, b0, c0, a1, b1, c1 = a[i], b[i], c[i], a[i + 1], b[i + 1], c[i + 1]
            for j in range(width):
                aj, bj, cj = a[j], b[j], c[j]
                P[i, j] -= a0 * aj + b0 * bj + c0 * cj
                P[i + 1, j] -= a1 * aj + b1 * bj + c1 * cj
    _give_back(space, P, n, A)


@jit(inline=True)
def add_and_subtract(space: Key, P: Floats, n: int, U: Floats, A: Floats) -> None:
    """P <- P + U^T U - A^T A in one pass."""
    width = (n + 7) // 8 * 8
    end_in_zeros(n, A)
    end_in_zeros(n, U)
    if len(space) == 2:
        u, a, b = U[0], A[0], A[1]
        for i in range(0, n, 2):
            u0, a0, b0, u1, a1, b1 = u[i], a[i], b[i], u[i + 1], a[i + 1], b[i + 1]
            for j in range(width):
                uj, aj, bj = u[j], a[j], b[j]
                P[i, j] += u0 * uj - (a0 * aj + b0 * bj)
                P[i + 1, j] += u1 * uj - (a1 * aj + b1 * bj)
    else:
        u, v, w, a, b, c = U[0], U[1], U[2], A[0], A[1], A[2]
        for i in range(0, n, 2):
            u0, v0, w0, u1, v1, w1 = u[i], v[i], w[i], u[i + 1], v[i + 1], w[i + 1]
            a0, b0, c0, a1, b1, c1 = a[i], b[i], c[i], a[i + 1], b[i + 1], c[i + 1]
            for j in range(width):
                uj, vj, wj, aj, bj, cj = u[j], v[j], w[j], a[j], b[j], c[j]
                P[i, j] += (u0 * uj + v0 * vj + w0 * wj) - (a0 * aj + b0 * bj + c0 * cj)
                P[i + 1, j] += (u1 * uj + v1 * vj + w1 * wj) - (a1 * aj + b1 * bj + c1 * cj)
    _give_back(space, P, n, A)


@jit(inline=True)
def _give_back(space: Key, P: Floats, n: int, A: Floats) -> None:
    floor = _ROUNDING * n
    if len(space) == 2:
        a, b = A[0], A[1]
        for i in range(n):
            P[i, i] += floor * (P[i, i] + a[i] * a[i] + b[i] * b[i])
    else:
        a, b, c = A[0], A[1], A[2]
        for i in range(n):
            P[i, i] += floor * (P[i, i] + a[i] * a[i] + b[i] * b[i] + c[i] * c[i])


@jit(inline=True)
def end_in_zeros(n: int, rows: Floats) -> None:
    """Clear what lies between entry n of each row and the end of its cache line."""
    for i in range(rows.shape[0]):
        for j in range(n, (n + 7) // 8 * 8):
            rows[i, j] = 0.0


@jit(inline=True)
def gain_columns(space: Key, P: Floats, n: int, k: int, by_rotation: bool, A: Floats, w: Floats) -> None:
    """A <- H P for H = ``GAIN`` on l - p, and ``TURNING`` on the rotation, of the landmark at place k."""
    if len(space) == 2:
        g00, g01, g10, g11 = w[GAIN], w[GAIN + 1], w[GAIN + 2], w[GAIN + 3]
        a, b = A[0], A[1]
        px, py, heading, lx, ly = P[0], P[1], P[2], P[k], P[k + 1]
        for j in range(n):
            e0 = lx[j] - px[j]
            e1 = ly[j] - py[j]
            a[j] = g00 * e0 + g01 * e1
            b[j] = g10 * e0 + g11 * e1
        if by_rotation:
            t0, t1 = w[TURNING], w[TURNING + 1]
            for j in range(n):
                a[j] += t0 * heading[j]
                b[j] += t1 * heading[j]
    else:
        _gain_in_space(P, n, k, A[0], A[1], A[2], w)
        if by_rotation:
            _gain_by_rotation(P, n, A[0], A[1], A[2], w)


@jit()
def _gain_in_space(P: Floats, n: int, k: int, a: Floats, b: Floats, c: Floats, w: Floats) -> None:
    g00, g01, g02, g10, g11, g12 = w[GAIN], w[GAIN + 1], w[GAIN + 2], w[GAIN + 3], w[GAIN + 4], w[GAIN + 5]
    g20, g21, g22 = w[GAIN + 6], w[GAIN + 7], w[GAIN + 8]
    px, py, pz, lx, ly, lz = P[0], P[1], P[2], P[k], P[k + 1], P[k + 2]
    for j in range(n):
        e0, e1, e2 = lx[j] - px[j], ly[j] - py[j], lz[j] - pz[j]
        a[j] = g00 * e0 + g01 * e1 + g02 * e2
        b[j] = g10 * e0 + g11 * e1 + g12 * e2
        c[j] = g20 * e0 + g21 * e1 + g22 * e2


@jit()
def _gain_by_rotation(P: Floats, n: int, a: Floats, b: Floats, c: Floats, w: Floats) -> None:
    for i in range(3):
        t0, t1, t2, row = w[TURNING + i], w[TURNING + 3 + i], w[TURNING + 6 + i], P[3 + i]
        for j in range(n):
            a[j] += t0 * row[j]
            b[j] += t1 * row[j]
            c[j] += t2 * row[j]


@jit(inline=True)
def gain_of_prediction(space: Key, n: int, k: int, U: Floats, A: Floats, w: Floats) -> None:
    """A <- A + (H U^T) U: what the prediction that is still to be added brings to the gain."""
    for b in range(U.shape[0]):
        u = U[b]
        for a in range(len(space)):
            weight, row = 0.0, A[a]
            for i in range(len(space)):
                weight += w[GAIN + len(space) * a + i] * (u[k + i] - u[i])
            for j in range(n):
                row[j] += weight * u[j]


@jit(inline=True)
def whiten(space: Key, n: int, A: Floats, w: Floats) -> None:
    """A <- L^-1 A, with L the factor at ``INNOVATION_COVARIANCE``."""
    L = INNOVATION_COVARIANCE
    if len(space) == 2:
        l00, l10, l11 = w[L], w[L + 2], w[L + 3]
        a, b = A[0], A[1]
        for j in range(n):
            a[j] /= l00
            b[j] = (b[j] - l10 * a[j]) / l11
    else:
        r0, r1, r2 = 1.0 / w[L], 1.0 / w[L + 4], 1.0 / w[L + 8]
        l10, l20, l21 = w[L + 3], w[L + 6], w[L + 7]
        a, b, c = A[0], A[1], A[2]
        for j in range(n):
            aj = a[j] * r0
            bj = (b[j] - l10 * aj) * r1
            a[j], b[j] = aj, bj
            c[j] = (c[j] - l20 * aj - l21 * bj) * r2
