"""The factors of joining: what one closed sub-map says of its frame, its exit and shared landmarks.

A factor predicts the sub-map's local quantities from the global ones, (T_k, T_exit, L_i) ->
(T_k^-1 T_exit, T_k^-1 L_i), and takes xi of the prediction against the estimate in the filter's own
error: xi_theta = Log(R R^^T), on the right-invariant one xi_i = V(xi_theta)^-1 (l - exp(xi_theta) l^),
on the standard one l - l^. Its cost is xi^T P^-1 xi with P the estimate's covariance; landmarks that
no other sub-map holds are dropped from P, which marginalises them exactly.

Global variables are poses (position m, then heading or rotation vector rad), then landmarks (m);
increments are those of ``atlas.coordinates``. One source serves the plane and space (``geometry.space``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.atlas.cholesky import information
from submaps.atlas.coordinates import carried, left_inverse, left_inverse_slope, rotation, rotation_error
from submaps.errors import NumericalError
from submaps.geometry.small import (
    Matrix,
    angles,
    block,
    each,
    minus,
    negative,
    plus,
    pose_row,
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
from submaps.submap import Submap

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_RESIDUAL = (
    "void(UniTuple(int64, {}), boolean, float64[::1], float64[::1], float64[::1], float64[:, ::1], float64[::1],"
    "float64[:, ::1])"
)
_EQUATIONS = (
    "float64(UniTuple(int64, {}), float64[:, ::1], float64[::1], float64[:, ::1], float64[:, ::1], float64[::1])"
)


@jit()
def _set_rotation_rows(A: Matrix, J: Floats) -> None:
    """d(xi_theta) by frame and end: -+V^-1 R_k^T in space, where ``A`` is that, -+1 in the plane."""
    if len(A) == 2:
        J[2, 2], J[2, 5] = -1.0, 1.0
    else:
        put_block(negative(A), J, 3, 3)
        put_block(A, J, 3, 9)


@jit(_RESIDUAL.format(2), _RESIDUAL.format(3))
def residual(
    space: Key, invariant: bool, estimate: Floats, frame: Floats, end: Floats, points: Floats, xi: Floats, J: Floats
) -> None:
    """xi (d,) of the prediction against the estimate, and its Jacobian J.

    ``estimate`` (d,) is local: exit pose (pose), landmarks (dim each). ``frame``, ``end`` are the global
    poses (pose,), ``points`` (s, dim) the global landmarks. J (d, 2 pose + dim) holds, row by row, d/d(frame),
    d/d(end) and d/d(own landmark): a landmark's rows depend on no other landmark.
    """
    dim = len(space)
    pose = 3 * dim - 3
    phi = rotation_error(angles(space, frame), angles(space, end), angles(space, estimate))
    to_frame = transposed(rotation(angles(space, frame)))
    W, series = left_inverse(phi)
    E, A = rotation(phi), product(W, to_frame)
    J[:] = 0.0
    put(phi, xi, dim)
    _set_rotation_rows(A, J)
    if not invariant:
        A = to_frame
    origin = vector(space, frame, 0)
    for i in range(points.shape[0] + 1):
        at = 0 if i == 0 else pose + dim * (i - 1)
        away = minus(vector(space, end, 0) if i == 0 else row(space, points, i - 1, 0), origin)
        turned = each(A, turn(away))  # dl = R^T (dg - dp - turn(g - p) delta)
        put_block(negative(A), J, at, 0)
        put_block(A, J, at, pose if i == 0 else 2 * pose)
        estimated, local = vector(space, estimate, at), times(to_frame, away)
        if invariant:
            # dphi = W R^T (delta' - delta) and d(xi) = (slope - W turn(r) V) dphi, r = exp(phi) l^
            r = times(E, estimated)
            v = minus(local, r)
            put(times(W, v), xi, at)
            slopes = carried(left_inverse_slope(phi, series, v), A)
            falls = carried(each(W, turn(r)), to_frame)
            for j in range(len(slopes)):
                by_end = minus(slopes[j], falls[j])
                put_column(by_end, J, at, pose + dim + j)
                put_column(scaled(-1.0, plus(by_end, 1.0, turned[j])), J, at, dim + j)
        else:
            put(minus(local, estimated), xi, at)
            for j in range(len(turned)):
                put_column(scaled(-1.0, turned[j]), J, at, dim + j)


@jit(_EQUATIONS.format(2), _EQUATIONS.format(3))
def normal_equations(space: Key, information: Floats, xi: Floats, J: Floats, H: Floats, g: Floats) -> float:
    """Gauss-Newton block H = J^T P^-1 J and gradient g = J^T P^-1 xi; returns the cost xi^T P^-1 xi.

    H (pose + d, pose + d), g (pose + d,) in the order frame, end, landmarks. Only H's lower triangle
    counts. Uses that each landmark's rows of J reach frame, end and that landmark alone.
    """
    dim = len(space)
    pose = 3 * dim - 3
    ends, d = 2 * pose, xi.shape[0]
    weighted, y = np.empty((d, ends)), np.empty(d)  # P^-1 times J's pose columns, and times xi
    cost = 0.0
    for i in range(d):
        p = information[i, 0]
        total = p * xi[0]
        by_frame, by_end = scaled(p, pose_row(space, J, 0, 0)), scaled(p, pose_row(space, J, 0, pose))
        for k in range(1, d):
            p = information[i, k]
            total += p * xi[k]
            by_frame, by_end = plus(by_frame, p, pose_row(space, J, k, 0)), plus(by_end, p, pose_row(space, J, k, pose))
        put(by_frame, weighted[i], 0)
        put(by_end, weighted[i], pose)
        y[i] = total
        cost += total * xi[i]
    for a in range(ends):
        total = 0.0
        for k in range(d):
            total += J[k, a] * y[k]
        g[a] = total
        for b in range(a + 1):
            total = 0.0
            for k in range(d):
                total += J[k, a] * weighted[k, b]
            H[a, b] = total
    for i in range(pose, d, dim):
        by_own = transposed(block(space, J, i, ends))
        r = i + pose
        put(times(by_own, vector(space, y, i)), g, r)
        for b in range(0, ends, dim):
            put_block(product(by_own, block(space, weighted, i, b)), H, r, b)
        for k in range(pose, i + 1, dim):
            weight = product(by_own, block(space, information, i, k))
            put_block(product(weight, block(space, J, k, ends)), H, r, k + pose)
    return cost


def rows_of(submap: Submap, landmarks: list[int]) -> Ints:
    """Entries of a sub-map's state for its pose and the named landmarks."""
    space, slot = submap.space, submap.slots()
    own = [slot[i] + a for i in landmarks for a in range(space.dim)]
    return np.array([*range(space.pose), *own], dtype=np.int64)


def factor(submap: Submap, rows: Ints) -> tuple[Floats, Floats]:
    """Estimate (d,) and information (d, d) of a sub-map's state entries ``rows``.

    Raises ``NumericalError`` where the covariance is not positive definite.
    """
    out = np.empty((rows.shape[0], rows.shape[0]))
    if not information(submap.covariance(rows), out):
        raise NumericalError(f"submap {submap.number}: its covariance is not positive definite")
    return submap.mean[rows], out
