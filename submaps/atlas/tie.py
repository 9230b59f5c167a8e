"""The transform between two sub-maps that hold landmarks in common, by weighted least squares."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.atlas.cholesky import cholesky, information
from submaps.atlas.coordinates import retract_one, rotation
from submaps.geometry import so3
from submaps.geometry.small import (
    Matrix,
    angles,
    block,
    minus,
    plus,
    product,
    put,
    put_block,
    put_column,
    row,
    scaled,
    times,
    transposed,
    turn,
    vector,
)
from submaps.geometry.space import Key
from submaps.geometry.trig import arctan2

Floats = NDArray[np.float64]
_ITERATIONS = 10
_CONVERGED = 1e-10

_rotation_vector = so3.rotation_vector


@jit()
def _start(space: Key, A: Floats, B: Floats, T: Floats) -> None:
    """The rigid transform that takes B onto A best with equal weights, in closed form.

    In the plane Umeyama 1991, in space the quaternion of Horn 1987: the eigenvector of a symmetric
    (4, 4) matrix of the sums S of products.
    """
    n, dim = A.shape[0], len(space)
    a, b = scaled(1.0 / n, row(space, A, 0, 0)), scaled(1.0 / n, row(space, B, 0, 0))
    for i in range(1, n):
        a, b = plus(a, 1.0 / n, row(space, A, i, 0)), plus(b, 1.0 / n, row(space, B, i, 0))
    S = np.zeros((dim, dim))
    for i in range(n):
        for j in range(dim):
            for k in range(dim):
                S[j, k] += (B[i, j] - b[j]) * (A[i, k] - a[k])
    if dim == 2:
        T[2] = arctan2(S[0, 1] - S[1, 0], S[0, 0] + S[1, 1])
    else:
        N = np.empty((4, 4))  # of (x, y, z, w)
        N[3, 3] = S[0, 0] + S[1, 1] + S[2, 2]
        for j in range(3):
            k, m = (j + 1) % 3, (j + 2) % 3
            N[j, j] = S[j, j] - S[k, k] - S[m, m]
            N[j, k] = N[k, j] = S[j, k] + S[k, j]
            N[j, 3] = N[3, j] = S[k, m] - S[m, k]
        q = np.linalg.eigh(N)[1][:, 3]
        T[3], T[4], T[5] = _rotation_vector((q[0], q[1], q[2], q[3]))
    put(minus(a, times(rotation(angles(space, T)), b)), T, 0)


@jit()
def _turned_covariance(space: Key, cov_a: Floats, R: Matrix, cov_b: Floats, C: Floats) -> None:
    """C <- cov_a + R cov_b R^T, block by block; the lower triangle alone."""
    dim, back = len(space), transposed(R)
    for p in range(0, C.shape[0], dim):
        for q in range(0, p + 1, dim):
            put_block(product(product(R, block(space, cov_b, p, q)), back), C, p, q)
        for k in range(p + dim):
            for a in range(dim):
                C[p + a, k] += cov_a[p + a, k]


@jit()
def _whiten(space: Key, A: Floats, B: Floats, T: Floats, R: Matrix, L: Floats, out: Floats) -> None:
    """out (dim n, pose + 1) <- L^-1 [J, r], with r_i = a_i - T b_i and J = [I, turn(R b_i)] = -dr/dT."""
    dim, position = len(space), vector(space, T, 0)
    pose = 3 * dim - 3
    out[:] = 0.0
    for i in range(A.shape[0]):
        turned = times(R, row(space, B, i, 0))
        columns = turn(turned)
        for a in range(dim):
            out[dim * i + a, a] = 1.0
        for j in range(len(columns)):
            put_column(columns[j], out, dim * i, dim + j)
        put_column(minus(minus(row(space, A, i, 0), position), turned), out, dim * i, pose)
    for i in range(out.shape[0]):
        for a in range(pose + 1):
            total = out[i, a]
            for k in range(i):
                total -= L[i, k] * out[k, a]
            out[i, a] = total / L[i, i]


@jit()
def _times_in_place(A: Floats, v: Floats) -> float:
    """v <- A v; its largest entry."""
    before, largest = v.copy(), 0.0
    for i in range(v.shape[0]):
        total = 0.0
        for k in range(v.shape[0]):
            total += A[i, k] * before[k]
        v[i] = total
        largest = max(largest, abs(total))
    return largest


_FIT = (
    "boolean(UniTuple(int64, {}), float64[:, ::1], float64[:, ::1], float64[:, ::1], float64[:, ::1], float64[::1],"
    "float64[:, ::1])"
)


@jit(_FIT.format(2), _FIT.format(3))
def fit(space: Key, A: Floats, B: Floats, cov_a: Floats, cov_b: Floats, T: Floats, covariance: Floats) -> bool:
    """T_a_b (pose,) = argmin r^T C^-1 r and its (pose, pose) covariance, written in place.

    r_i = a_i - T b_i for points A, B (n, dim) with covariances (dim n, dim n); C = C_a + R C_b R^T, and the
    covariance of the additive errors is (J^T C^-1 J)^-1. False where C is not positive definite.
    """
    n, dim = A.shape[0], len(space)
    pose = 3 * dim - 3
    C, whitened = np.empty((dim * n, dim * n)), np.empty((dim * n, pose + 1))
    H, step = np.empty((pose, pose)), np.empty(pose)
    _start(space, A, B, T)
    for _ in range(_ITERATIONS):
        R = rotation(angles(space, T))
        _turned_covariance(space, cov_a, R, cov_b, C)
        if not cholesky(C):
            return False
        _whiten(space, A, B, T, R, C, whitened)
        for a in range(pose):
            for b in range(pose):
                total = 0.0
                for i in range(dim * n):
                    total += whitened[i, a] * whitened[i, b]
                H[a, b] = total
        if not information(H, covariance):
            return False
        step[:] = 0.0
        for i in range(dim * n):
            for a in range(pose):
                step[a] += whitened[i, a] * whitened[i, pose]
        largest = _times_in_place(covariance, step)
        retract_one(space, T, step)
        if largest < _CONVERGED:
            break
    return True
