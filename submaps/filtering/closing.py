"""Closing a sub-map inside the compiled walk: packed onto a shelf, its arrays ready for the next."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.filtering.kernel import add_rank_one, predict_invariant, predict_standard
from submaps.filtering.layout import COUNTS, DIM, NIS_COUNT, NIS_SUM, NOISE

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# A parked or slip-free vehicle leaves the pose's covariance singular, and a factor needs all of its
# pivots. The heading's floor is the smaller: its error grows with a landmark's distance.
POSITION_FLOOR_M = 1e-4
HEADING_FLOOR_RAD = 2e-7
# Places in a row of ``Shelf.whole`` after the counts: the step at which the sub-map closed.
STEP, ROW = COUNTS, COUNTS + 1
# Places in ``Shelf.fill``: sub-maps, reals, ids.
CLOSED, REALS, IDS = 0, 1, 2


@jit()
def predict(x: Floats, P: Floats, n: int, motion: Floats, invariant: int, u: Floats) -> bool:
    """Predict with the pending increment and clear it; whether ``u`` holds a rank-one term still to be added."""
    noise = motion[NOISE : NOISE + 9].reshape(3, 3)
    has_u = False
    if invariant:
        has_u = predict_invariant(x, P, n, motion[:3], noise, u)
    else:
        predict_standard(x, P, n, motion[:3], noise)
    motion[:NIS_SUM] = 0.0
    return has_u


@jit("void(float64[::1], float64[:, ::1], int64[::1], float64[::1], int64, float64[:, ::1])")
def flush(x: Floats, P: Floats, counts: Ints, motion: Floats, invariant: int, scratch: Floats) -> None:
    """Predict with the pending increment and clear it, on x, P and ``motion`` in place."""
    has_u = predict(x, P, counts[DIM], motion, invariant, scratch[0])
    if has_u:
        add_rank_one(P, counts[DIM], scratch[0])


@jit("void(float64[:, ::1], int64, float64[::1])")
def pack(P: Floats, n: int, out: Floats) -> None:
    """Lower triangle of the leading (n, n) block, row by row, the pose's pivots raised to the floors.

    The pivots are taken in the order theta, x, y.
    """
    k = 0
    for i in range(n):
        for j in range(i + 1):
            out[k] = P[i, j]
            k += 1
    xx, xy, yy, xt, yt, tt = out[0], out[1], out[2], out[3], out[4], out[5]
    tt = max(tt, HEADING_FLOOR_RAD**2)
    xx += max(POSITION_FLOOR_M**2 - (xx - xt * xt / tt), 0.0)
    rest = xx - xt * xt / tt
    mixed = xy - xt * yt / tt
    yy += max(POSITION_FLOOR_M**2 - (yy - yt * yt / tt - mixed * mixed / rest), 0.0)
    out[0], out[2], out[5] = xx, yy, tt


@jit()
def begin(x: Floats, P: Floats, counts: Ints, motion: Floats) -> None:
    """Make the arrays those of a sub-map that begins: the origin, and nothing else.

    Beyond the state's dimension they may hold what was there: ``augment`` writes a landmark's rows
    and columns whole.
    """
    counts[:] = 0
    counts[DIM] = 3
    motion[:] = 0.0
    x[:3] = 0.0
    P[:3, :3] = 0.0


@jit()
def close(
    step: int, x: Floats, P: Floats, ids: Ints, counts: Ints, motion: Floats, invariant: int,
    slot_of: NDArray[np.int32], scratch: Floats, whole: Ints, reals: Floats, numbers: Ints, fill: Ints,
) -> bool:  # fmt: skip
    """Predict to the present pose, put the sub-map on the shelf, and begin the next; false without room."""
    n = counts[DIM]
    held = (n - 3) // 2
    row, at, first = fill[CLOSED], fill[REALS], fill[IDS]
    size = n + n * (n + 1) // 2 + 2
    if row == whole.shape[0] or at + size > reals.shape[0] or first + held > numbers.shape[0]:
        return False
    if predict(x, P, n, motion, invariant, scratch[0]):
        add_rank_one(P, n, scratch[0])
    reals[at : at + n] = x[:n]
    pack(P, n, reals[at + n : at + size - 2])
    reals[at + size - 2] = motion[NIS_SUM]
    reals[at + size - 1] = motion[NIS_COUNT]
    whole[row, :COUNTS] = counts
    whole[row, STEP] = step
    for i in range(held):
        numbers[first + i] = ids[i]
        slot_of[ids[i]] = -1
    fill[CLOSED], fill[REALS], fill[IDS] = row + 1, at + size, first + held
    begin(x, P, counts, motion)
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
