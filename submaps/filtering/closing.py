"""Closing a sub-map inside the compiled walk: packed onto a shelf, its arrays ready for the next."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.filtering.forgetting import replace_pose_additive
from submaps.filtering.layout import COUNTS, DIM, INVARIANT, MOTIONLESS, NIS_COUNT, NIS_SUM
from submaps.filtering.passes import add
from submaps.filtering.predicting import predict
from submaps.geometry.space import Key

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# A parked or slip-free vehicle leaves the pose's covariance singular, and a factor needs all of its
# pivots. The heading's floor is the smaller: its error grows with a landmark's distance.
POSITION_FLOOR_M = 1e-4
HEADING_FLOOR_RAD = 2e-7
# How little an exit pose says where nothing is known of the motion: beside a landmark's centimetres, nothing.
FLAT_POSITION_M = 1e3
FLAT_ROTATION_RAD = 10.0
# Places in a row of ``Shelf.whole`` after the counts: the step at which the sub-map closed.
STEP, ROW = COUNTS, COUNTS + 1
# Places in ``Shelf.fill``: sub-maps, reals, ids.
CLOSED, REALS, IDS = 0, 1, 2


@jit()
def _take_in(space: Key, x: Floats, P: Floats, n: int, motion: Floats, invariant: int, scratch: Floats) -> None:
    U = scratch[: 2 * len(space) - 3]
    if predict(space, x, P, n, motion, invariant, U):
        add(space, P, n, U)


@jit(
    "void(UniTuple(int64, 2), float64[::1], float64[:, ::1], int64[::1], float64[::1], int64, float64[:, ::1])",
    "void(UniTuple(int64, 3), float64[::1], float64[:, ::1], int64[::1], float64[::1], int64, float64[:, ::1])",
)
def flush(space: Key, x: Floats, P: Floats, counts: Ints, motion: Floats, invariant: int, scratch: Floats) -> None:
    """Predict with the pending increment and clear it, on x, P and ``motion`` in place."""
    _take_in(space, x, P, counts[DIM], motion, invariant, scratch)


@jit(
    "void(UniTuple(int64, 2), float64[:, ::1], int64, float64[::1])",
    "void(UniTuple(int64, 3), float64[:, ::1], int64, float64[::1])",
)
def pack(space: Key, P: Floats, n: int, out: Floats) -> None:
    """Lower triangle of the leading (n, n) block, row by row, the pose's pivots raised to the floors.

    The pivots are taken in the order rotation, position.
    """
    k = 0
    for i in range(n):
        for j in range(i + 1):
            out[k] = P[i, j]
            k += 1
    dim, rot = len(space), 2 * len(space) - 3
    M, pivots = np.empty((dim + rot, dim + rot)), np.empty(dim + rot)
    for a in range(dim + rot):
        i = dim + a if a < rot else a - rot
        least = HEADING_FLOOR_RAD**2 if a < rot else POSITION_FLOOR_M**2
        for b in range(a + 1):
            j = dim + b if b < rot else b - rot
            total = P[i, j]
            for c in range(b):
                total -= M[a, c] * M[b, c] / pivots[c]
            M[a, b] = total
        missing = max(least - M[a, a], 0.0)
        out[i * (i + 1) // 2 + i] += missing
        pivots[a] = M[a, a] + missing


@jit()
def begin(space: Key, x: Floats, P: Floats, counts: Ints, motion: Floats) -> None:
    """Make the arrays those of a sub-map that begins: the origin, and nothing else.

    Beyond the state's dimension they may hold what was there: ``augment`` writes a landmark's rows
    and columns whole.
    """
    pose = 3 * len(space) - 3
    counts[:] = 0
    counts[DIM] = pose
    motion[:] = 0.0
    x[:pose] = 0.0
    P[:pose, :pose] = 0.0


@jit()
def close(
    space: Key, step: int, x: Floats, P: Floats, ids: Ints, counts: Ints, motion: Floats, settings: Ints,
    slot_of: NDArray[np.int32], scratch: Floats, whole: Ints, reals: Floats, numbers: Ints, fill: Ints,
) -> bool:  # fmt: skip
    """Predict to the present pose, put the sub-map on the shelf, and begin the next; false without room."""
    n = counts[DIM]
    held = (n - (3 * len(space) - 3)) // len(space)
    row, at, first = fill[CLOSED], fill[REALS], fill[IDS]
    size = n + n * (n + 1) // 2 + 2
    if row == whole.shape[0] or at + size > reals.shape[0] or first + held > numbers.shape[0]:
        return False
    _take_in(space, x, P, n, motion, settings[INVARIANT], scratch)
    if len(space) == 3 and settings[MOTIONLESS] != 0:
        # The pose is a guess at where the next sub-map begins, from readings that go into that one. On the
        # invariant error all landmarks would turn with it, and what is known of them be lost in rounding.
        flat = np.zeros((6, 6))
        for i in range(3):
            flat[i, i], flat[3 + i, 3 + i] = FLAT_POSITION_M**2, FLAT_ROTATION_RAD**2
        replace_pose_additive(x, P, n, settings[INVARIANT] != 0, flat)
    reals[at : at + n] = x[:n]
    pack(space, P, n, reals[at + n : at + size - 2])
    reals[at + size - 2] = motion[NIS_SUM]
    reals[at + size - 1] = motion[NIS_COUNT]
    whole[row, :COUNTS] = counts
    whole[row, STEP] = step
    for i in range(held):
        numbers[first + i] = ids[i]
        slot_of[ids[i]] = -1
    fill[CLOSED], fill[REALS], fill[IDS] = row + 1, at + size, first + held
    begin(space, x, P, counts, motion)
    return True


class Shelf:
    """Room for sub-maps that close during a walk, until Python takes them."""

    def __init__(self, rows: int, reals: int) -> None:
        self.whole = np.empty((rows, ROW), dtype=np.int64)
        self.reals = np.empty(reals)
        self.ids = np.empty(max(reals // 4, rows), dtype=np.int64)
        self.fill = np.zeros(3, dtype=np.int64)

    def clear(self) -> None:
        """Make all room free again."""
        self.fill[:] = 0

    def twice(self) -> Shelf:
        """An empty shelf with twice the room."""
        return Shelf(2 * self.whole.shape[0], 2 * self.reals.shape[0])
