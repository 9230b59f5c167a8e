"""The transform between two sub-maps that hold landmarks in common, by weighted least squares."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.atlas.factors import cholesky, information
from submaps.geometry.trig import arctan2, sincos, wrap

Floats = NDArray[np.float64]
_ITERATIONS = 10
_CONVERGED = 1e-10


@jit()
def _start(A: Floats, B: Floats, T: Floats) -> None:
    """The rigid transform that takes B onto A best with equal weights, in closed form (Umeyama 1991)."""
    n = A.shape[0]
    a0 = a1 = b0 = b1 = cross = dot = 0.0
    for i in range(n):
        a0, a1, b0, b1 = a0 + A[i, 0] / n, a1 + A[i, 1] / n, b0 + B[i, 0] / n, b1 + B[i, 1] / n
    for i in range(n):
        cross += (B[i, 0] - b0) * (A[i, 1] - a1) - (B[i, 1] - b1) * (A[i, 0] - a0)
        dot += (B[i, 0] - b0) * (A[i, 0] - a0) + (B[i, 1] - b1) * (A[i, 1] - a1)
    T[2] = arctan2(cross, dot)
    s, c = sincos(T[2])
    T[0], T[1] = a0 - c * b0 + s * b1, a1 - s * b0 - c * b1


@jit("boolean(float64[:, ::1], float64[:, ::1], float64[:, ::1], float64[:, ::1], float64[::1], float64[:, ::1])")
def fit(A: Floats, B: Floats, cov_a: Floats, cov_b: Floats, T: Floats, covariance: Floats) -> bool:
    """T_a_b (x m, y m, theta rad) = argmin r^T C^-1 r and its (3, 3) covariance, written in place.

    r_i = a_i - T b_i for points A, B (n, 2) with covariances (2n, 2n); C = C_a + R C_b R^T, and the
    covariance is (J^T C^-1 J)^-1. False where C is not positive definite.
    """
    n = A.shape[0]
    C = np.empty((2 * n, 2 * n))
    whitened = np.empty((2 * n, 4))  # L^-1 [J, r]
    H = np.empty((3, 3))
    g = np.empty(3)
    _start(A, B, T)
    for _ in range(_ITERATIONS):
        s, c = sincos(T[2])
        for i in range(n):
            for j in range(n):
                p, q = 2 * i, 2 * j
                b00, b01, b10, b11 = cov_b[p, q], cov_b[p, q + 1], cov_b[p + 1, q], cov_b[p + 1, q + 1]
                left00, left01 = c * b00 - s * b10, c * b01 - s * b11
                left10, left11 = s * b00 + c * b10, s * b01 + c * b11
                C[p, q] = cov_a[p, q] + left00 * c - left01 * s
                C[p, q + 1] = cov_a[p, q + 1] + left00 * s + left01 * c
                C[p + 1, q] = cov_a[p + 1, q] + left10 * c - left11 * s
                C[p + 1, q + 1] = cov_a[p + 1, q + 1] + left10 * s + left11 * c
            turned0, turned1 = c * B[i, 0] - s * B[i, 1], s * B[i, 0] + c * B[i, 1]
            whitened[2 * i] = (1.0, 0.0, -turned1, A[i, 0] - T[0] - turned0)
            whitened[2 * i + 1] = (0.0, 1.0, turned0, A[i, 1] - T[1] - turned1)
        if not cholesky(C):
            return False
        for i in range(2 * n):
            for a in range(4):
                total = whitened[i, a]
                for k in range(i):
                    total -= C[i, k] * whitened[k, a]
                whitened[i, a] = total / C[i, i]
        for a in range(3):
            g[a] = 0.0
            for i in range(2 * n):
                g[a] += whitened[i, a] * whitened[i, 3]
            for b in range(3):
                H[a, b] = 0.0
                for i in range(2 * n):
                    H[a, b] += whitened[i, a] * whitened[i, b]
        if not information(H, covariance):
            return False
        largest = 0.0
        for a in range(3):
            step = covariance[a, 0] * g[0] + covariance[a, 1] * g[1] + covariance[a, 2] * g[2]
            T[a] += step
            largest = max(largest, abs(step))
        T[2] = wrap(T[2])
        if largest < _CONVERGED:
            break
    return True
