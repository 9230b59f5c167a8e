"""Dense Cholesky factorisation and inverse of small positive definite matrices, compiled."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit

Floats = NDArray[np.float64]


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
