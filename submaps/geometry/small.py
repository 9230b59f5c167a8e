"""Vectors and matrices of the plane and space as tuples, which compiled code keeps in registers.

A matrix is a tuple of its rows, a map from a rotation's error (1 in the plane, 3 in space) a tuple of its
columns. Each function is compiled for each length anew, and of the branches not taken nothing is left.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.geometry.space import Key

Floats = NDArray[np.float64]
Vector = tuple[float, ...]
Matrix = tuple[Vector, ...]


# -- out of arrays, and into them ----------------------------------------------------------------


@jit()
def vector(space: Key, a: Floats, i: int) -> Vector:
    """Entries i .. i + dim - 1 of an array."""
    if len(space) == 2:
        return a[i], a[i + 1]
    return a[i], a[i + 1], a[i + 2]


@jit()
def angles(space: Key, pose: Floats) -> Vector:
    """The heading or rotation vector (rad) of a pose (pose,)."""
    if len(space) == 2:
        return (pose[2],)
    return pose[3], pose[4], pose[5]


@jit()
def row(space: Key, A: Floats, i: int, j: int) -> Vector:
    """Entries j .. j + dim - 1 of row i."""
    if len(space) == 2:
        return A[i, j], A[i, j + 1]
    return A[i, j], A[i, j + 1], A[i, j + 2]


@jit()
def pose_row(space: Key, A: Floats, i: int, j: int) -> Vector:
    """Entries j .. j + pose - 1 of row i."""
    if len(space) == 2:
        return A[i, j], A[i, j + 1], A[i, j + 2]
    return A[i, j], A[i, j + 1], A[i, j + 2], A[i, j + 3], A[i, j + 4], A[i, j + 5]


@jit()
def block(space: Key, A: Floats, i: int, j: int) -> Matrix:
    """The (dim, dim) block of A at i, j."""
    if len(space) == 2:
        return row(space, A, i, j), row(space, A, i + 1, j)
    return row(space, A, i, j), row(space, A, i + 1, j), row(space, A, i + 2, j)


@jit()
def put(v: Vector, a: Floats, i: int) -> None:
    """Write a vector of 1, 2, 3 or 6 entries to i and on."""
    a[i] = v[0]
    if len(v) > 1:
        a[i + 1] = v[1]
    if len(v) > 2:
        a[i + 2] = v[2]
    if len(v) > 3:
        a[i + 3], a[i + 4], a[i + 5] = v[3], v[4], v[5]


@jit()
def put_block(M: Matrix, A: Floats, i: int, j: int) -> None:
    """Write a (dim, dim) block to A at i, j."""
    if len(M) == 2:
        A[i, j], A[i, j + 1] = M[0]
        A[i + 1, j], A[i + 1, j + 1] = M[1]
    else:
        A[i, j], A[i, j + 1], A[i, j + 2] = M[0]
        A[i + 1, j], A[i + 1, j + 1], A[i + 1, j + 2] = M[1]
        A[i + 2, j], A[i + 2, j + 1], A[i + 2, j + 2] = M[2]


@jit()
def put_column(v: Vector, A: Floats, i: int, j: int) -> None:
    """Write a vector to column j of A, from row i down."""
    A[i, j], A[i + 1, j] = v[0], v[1]
    if len(v) == 3:
        A[i + 2, j] = v[2]


# -- algebra -------------------------------------------------------------------------------------


@jit()
def plus(a: Vector, factor: float, b: Vector) -> Vector:
    """a + factor b, of 2, 3 or 6 entries."""
    if len(a) == 2:
        return a[0] + factor * b[0], a[1] + factor * b[1]
    if len(a) == 3:
        return a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]
    return (
        a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2],
        a[3] + factor * b[3], a[4] + factor * b[4], a[5] + factor * b[5],
    )  # fmt: skip


@jit()
def minus(a: Vector, b: Vector) -> Vector:
    """a - b."""
    if len(a) == 2:
        return a[0] - b[0], a[1] - b[1]
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@jit()
def scaled(factor: float, a: Vector) -> Vector:
    """factor a, of 2, 3 or 6 entries."""
    if len(a) == 2:
        return factor * a[0], factor * a[1]
    if len(a) == 3:
        return factor * a[0], factor * a[1], factor * a[2]
    return factor * a[0], factor * a[1], factor * a[2], factor * a[3], factor * a[4], factor * a[5]


@jit()
def dot(a: Vector, b: Vector) -> float:
    """a . b."""
    if len(a) == 2:
        return a[0] * b[0] + a[1] * b[1]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@jit()
def times(M: Matrix, v: Vector) -> Vector:
    """M v."""
    if len(M) == 2:
        return dot(M[0], v), dot(M[1], v)
    return dot(M[0], v), dot(M[1], v), dot(M[2], v)


@jit()
def combined(weights: Vector, vectors: Matrix) -> Vector:
    """The sum of weights_i vectors_i, two or three: of rows weights^T M, of columns M weights."""
    first = plus(scaled(weights[0], vectors[0]), weights[1], vectors[1])
    if len(weights) == 2:
        return first
    return plus(first, weights[2], vectors[2])


@jit()
def negative(M: Matrix) -> Matrix:
    """-M."""
    if len(M) == 2:
        return scaled(-1.0, M[0]), scaled(-1.0, M[1])
    return scaled(-1.0, M[0]), scaled(-1.0, M[1]), scaled(-1.0, M[2])


@jit()
def product(A: Matrix, B: Matrix) -> Matrix:
    """A B."""
    if len(A) == 2:
        return combined(A[0], B), combined(A[1], B)
    return combined(A[0], B), combined(A[1], B), combined(A[2], B)


@jit()
def transposed(M: Matrix) -> Matrix:
    """M^T."""
    if len(M) == 2:
        return (M[0][0], M[1][0]), (M[0][1], M[1][1])
    return (M[0][0], M[1][0], M[2][0]), (M[0][1], M[1][1], M[2][1]), (M[0][2], M[1][2], M[2][2])


@jit()
def each(M: Matrix, columns: Matrix) -> Matrix:
    """M times each column."""
    if len(columns) == 1:
        return (times(M, columns[0]),)
    return times(M, columns[0]), times(M, columns[1]), times(M, columns[2])


@jit()
def turn(p: Vector) -> Matrix:
    """turn(p), the columns of J p or -S(p): exp(e) p = p + turn(p) e (see ``geometry.space``)."""
    if len(p) == 2:
        return ((-p[1], p[0]),)
    return (0.0, -p[2], p[1]), (p[2], 0.0, -p[0]), (-p[1], p[0], 0.0)
