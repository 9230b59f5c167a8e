"""A reading of any number of channels as one of as many rows as there are dimensions."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.filtering.workspace import INNOVATION, NOISE, READING_NOISE, SLOPE, STEP
from submaps.geometry.space import Key

Floats = NDArray[np.float64]


@jit(inline=True)
def reduce(space: Key, count: int, R: Floats, w: Floats) -> float:
    """Bring ``SLOPE`` and ``INNOVATION`` of ``count`` channels to dim rows of noise ``NOISE``.

    A reading of fewer numbers gets rows that say nothing. One of more is whitened, L^-1 dh/dy = Q T, and
    replaced by Q^T L^-1 v = T dy + unit noise; returned is the squared norm of the rest of L^-1 v, which says
    nothing of the point.
    """
    dim = len(space)
    if count > dim:
        _whiten(dim, count, R, w)
        _orthogonalise(dim, count, w)
        return _project(dim, count, w)
    for a in range(dim):
        for b in range(dim):
            own = 1.0 if a == b else 0.0
            w[NOISE + dim * a + b] = R[a, b] if a < count and b < count else own
            if a >= count:
                w[SLOPE + dim * a + b] = 0.0
        if a >= count:
            w[INNOVATION + a] = 0.0
    return 0.0


@jit()
def _whiten(dim: int, count: int, R: Floats, w: Floats) -> None:
    """L^-1 of the slope and the innovation, in place, with R = L L^T."""
    L, H, v = READING_NOISE, SLOPE, INNOVATION
    for i in range(count):
        for j in range(i + 1):
            total = R[i, j]
            for k in range(j):
                total -= w[L + 4 * i + k] * w[L + 4 * j + k]
            w[L + 4 * i + j] = math.sqrt(total) if i == j else total / w[L + 4 * j + j]
        for k in range(i):
            w[v + i] -= w[L + 4 * i + k] * w[v + k]
            for j in range(dim):
                w[H + dim * i + j] -= w[L + 4 * i + k] * w[H + dim * k + j]
        w[v + i] /= w[L + 4 * i + i]
        for j in range(dim):
            w[H + dim * i + j] /= w[L + 4 * i + i]


@jit()
def _orthogonalise(dim: int, count: int, w: Floats) -> None:
    """Q in place of the slope, T to ``NOISE``: modified Gram-Schmidt."""
    H, T = SLOPE, NOISE
    for j in range(dim):
        norm = 0.0
        for i in range(count):
            norm += w[H + dim * i + j] * w[H + dim * i + j]
        norm = math.sqrt(norm)
        for i in range(count):
            w[H + dim * i + j] /= norm
        for k in range(dim):
            w[T + dim * j + k] = 0.0
        w[T + dim * j + j] = norm
        for k in range(j + 1, dim):
            dot = 0.0
            for i in range(count):
                dot += w[H + dim * i + j] * w[H + dim * i + k]
            w[T + dim * j + k] = dot
            for i in range(count):
                w[H + dim * i + k] -= dot * w[H + dim * i + j]


@jit()
def _project(dim: int, count: int, w: Floats) -> float:
    """Q^T v in place of v, T in place of Q, unit noise; the squared norm of what is left of v."""
    H, T, v = SLOPE, NOISE, INNOVATION
    for j in range(dim):
        dot = 0.0
        for i in range(count):
            dot += w[H + dim * i + j] * w[v + i]
        w[STEP + j] = dot
        for i in range(count):
            w[v + i] -= dot * w[H + dim * i + j]
    rest = 0.0
    for i in range(count):
        rest += w[v + i] * w[v + i]
    for j in range(dim):
        w[v + j] = w[STEP + j]
        for k in range(dim):
            w[H + dim * j + k] = w[T + dim * j + k]
            w[T + dim * j + k] = 1.0 if j == k else 0.0
    return rest
