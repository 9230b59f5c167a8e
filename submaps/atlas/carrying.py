"""What is known of a sub-map's frame, end and points, carried from one frame to another; compiled.

Each function writes where the points lie and the derivative D of what comes out by what goes in. Poses and
their increments are those of ``atlas.coordinates``; D is handed in as zeros.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.atlas.coordinates import carried, rotation
from submaps.geometry.small import (
    Matrix,
    Vector,
    angles,
    minus,
    negative,
    plus,
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

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@jit()
def _put_turned(columns: Matrix, factor: float, D: Floats, i: int, j: int) -> None:
    for a in range(len(columns)):
        put_column(scaled(factor, columns[a]), D, i, j + a)


@jit()
def _inside(space: Key, p: Vector, R: Matrix, beside: Vector, D: Floats, at: int, first: int, own: int) -> Vector:
    """A point in a frame (p, R) from one beside it: l = R^T (g - p), dl = R^T (dg - dp) - turn(l) R^T dtheta.

    In the plane turn(l) dtheta. Its rows of D begin at ``at``, the frame's columns at ``first``, its own at ``own``.
    """
    back = transposed(R)
    local = times(back, minus(beside, p))
    put_block(negative(back), D, at, first)
    _put_turned(carried(turn(local), back), -1.0, D, at, first + len(space))
    put_block(back, D, at, own)
    return local


@jit()
def _outside(space: Key, p: Vector, R: Matrix, local: Vector, D: Floats, at: int, own: int) -> Vector:
    """A point beside a frame (p, R), whose columns are the first: g = p + R l, dg = dp + turn(R l) dtheta + R dl."""
    turned = times(R, local)
    for a in range(len(space)):
        D[at + a, a] = 1.0
    _put_turned(turn(turned), 1.0, D, at, len(space))
    put_block(R, D, at, own)
    return plus(turned, 1.0, p)


@jit()
def _put_end(space: Key, p: Vector, R: Matrix, end: Floats, D: Floats, at: int) -> None:
    """The end beside a frame (p, R) from the one in it, whose columns follow the frame's: its rotation R R_end."""
    dim = len(space)
    pose = 3 * dim - 3
    _outside(space, p, R, vector(space, end, 0), D, at, pose)
    for a in range(dim, pose):
        D[at + a, a] = 1.0
        D[at + a, pose + a] = 1.0
    if dim == 3:
        put_block(R, D, at + 3, 9)


_INTO = "void(UniTuple(int64, {}), float64[::1], float64[:, ::1], float64[:, ::1], float64[:, ::1])"


@jit(_INTO.format(2), _INTO.format(3))
def into(space: Key, frame: Floats, beside: Floats, points: Floats, D: Floats) -> None:
    """(frame, points beside it) to (frame, points in it), D (pose + dim m, pose + dim m)."""
    dim = len(space)
    pose = 3 * dim - 3
    p, R = vector(space, frame, 0), rotation(angles(space, frame))
    for a in range(pose):
        D[a, a] = 1.0
    for i in range(points.shape[0]):
        at = pose + dim * i
        put(_inside(space, p, R, row(space, beside, i, 0), D, at, 0, at), points[i], 0)


_CARRY = (
    "void(UniTuple(int64, {}), float64[::1], float64[::1], float64[:, ::1], int64[::1], float64[:, ::1],"
    "float64[:, ::1])"
)


@jit(_CARRY.format(2), _CARRY.format(3))
def onward(space: Key, frame: Floats, end: Floats, points: Floats, kept: Ints, out: Floats, D: Floats) -> None:
    """(frame, end and points in it) to (the end beside the frame, ``kept`` points in the end)."""
    dim = len(space)
    pose = 3 * dim - 3
    _put_end(space, vector(space, frame, 0), rotation(angles(space, frame)), end, D, 0)
    p, R = vector(space, end, 0), rotation(angles(space, end))
    for i in range(kept.shape[0]):
        k = kept[i]
        own = 2 * pose + dim * k
        put(_inside(space, p, R, row(space, points, k, 0), D, pose + dim * i, pose, own), out[i], 0)


@jit(_CARRY.format(2), _CARRY.format(3))
def outward(space: Key, frame: Floats, end: Floats, points: Floats, kept: Ints, out: Floats, D: Floats) -> None:
    """(frame, end and points in it) to (frame, end and ``kept`` points beside it)."""
    dim = len(space)
    pose = 3 * dim - 3
    p, R = vector(space, frame, 0), rotation(angles(space, frame))
    for a in range(pose):
        D[a, a] = 1.0
    _put_end(space, p, R, end, D, pose)
    for i in range(kept.shape[0]):
        k = kept[i]
        own = 2 * pose + dim * k
        put(_outside(space, p, R, row(space, points, k, 0), D, 2 * pose + dim * i, own), out[i], 0)
