"""A sub-map's state as some controls will leave it, on copies: what the next observations are held against."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.filtering.closing import flush
from submaps.filtering.layout import DIM
from submaps.filtering.predicting import accumulate, accumulate_in_space, pending_of
from submaps.geometry.space import Key

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_TYPES = (
    "float64[::1], float64[:, ::1], int64[::1], float64[::1], int64, float64[:, ::1], float64[:, :, ::1],"
    "float64[::1], float64[:, ::1])"
)


@jit("void(UniTuple(int64, 2), " + _TYPES, "void(UniTuple(int64, 3), " + _TYPES)
def look_ahead(
    space: Key, x: Floats, P: Floats, counts: Ints, motion: Floats, invariant: int, increments: Floats, noises: Floats,
    to_x: Floats, to_P: Floats,
) -> None:  # fmt: skip
    """The leading entries of ``to_x`` and ``to_P`` <- the state predicted through increments (c, pose)."""
    n = counts[DIM]
    coming, scratch = motion.copy(), np.empty((3, x.shape[0]))
    pending, noise = pending_of(space, coming)
    for c in range(increments.shape[0]):
        if len(space) == 2:
            accumulate(pending, noise, increments[c], noises[c])
        else:
            accumulate_in_space(pending, noise, increments[c], noises[c])
    to_x[:n] = x[:n]
    to_P[:n, :n] = P[:n, :n]
    flush(space, to_x, to_P, counts, coming, invariant, scratch)
