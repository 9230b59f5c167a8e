"""The compiled walk over a batch's columns; it comes back to Python only for rare events."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.filtering.closing import CLOSED, close, predict
from submaps.filtering.kernel import (
    FIRST,
    GATED,
    SINGULAR,
    accumulate,
    add_rank_one,
    augment,
    update,
)
from submaps.filtering.layout import (
    BODY,
    DIM,
    DONE,
    FLAG,
    GATE,
    GENESIS,
    GROW,
    INVARIANT,
    MAX_HEADING_VARIANCE,
    MAX_LANDMARKS,
    MAX_POSITION_VARIANCE,
    MIN_OBSERVED,
    MODEL,
    MOUNT,
    NIS_COUNT,
    NIS_SUM,
    NOISE,
    OBSERVATIONS,
    OBSERVED,
    REJECTED,
    STEPS,
)
from submaps.geometry.trig import sincos, wrap
from submaps.observation.models import CARTESIAN

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@jit()
def _new_landmarks(landmark: Ints, slot_of: NDArray[np.int32], begin: int, end: int) -> int:
    """How many of these observations' landmarks the sub-map does not hold, each counted once."""
    new = 0
    for i in range(begin, end):
        if slot_of[landmark[i]] < 0:
            slot_of[landmark[i]] -= 1
            new += slot_of[landmark[i]] == -2
    for i in range(begin, end):
        if slot_of[landmark[i]] < 0:
            slot_of[landmark[i]] = -1
    return new


@jit()
def _position_variance(x: Floats, P: Floats, motion: Floats, invariant: bool) -> float:
    """Trace of the covariance (m^2) of the position's additive error, the pending increment taken in.

    The error is xi_p + J q xi_theta plus the increment's own, with q the position after it on the
    invariant error and the increment itself, R d, on the standard one.
    """
    s, c = sincos(x[2])
    q0 = c * motion[0] - s * motion[1] + (x[0] if invariant else 0.0)
    q1 = s * motion[0] + c * motion[1] + (x[1] if invariant else 0.0)
    own: float = P[0, 0] + P[1, 1] + motion[NOISE] + motion[NOISE + 4]
    own += 2.0 * (q0 * P[1, 2] - q1 * P[0, 2]) + (q0 * q0 + q1 * q1) * P[2, 2]
    return own


@jit()
def _wants_genesis(new: int, x: Floats, P: Floats, counts: Ints, motion: Floats, whole: Ints, real: Floats) -> bool:
    held = int(counts[DIM] - 3) // 2
    if held == 0 and counts[OBSERVED] == 0:
        return False
    full = new > 0 and held + new > int(whole[MAX_LANDMARKS])
    if motion[0] == 0.0 and motion[1] == 0.0 and motion[2] == 0.0:
        # A robot that stands still begins no sub-map, but a state must stay bounded.
        return new > 0 and held + new > 2 * int(whole[MAX_LANDMARKS])
    if full or counts[OBSERVED] < whole[MIN_OBSERVED]:
        return full
    heading = float(P[2, 2] + motion[NOISE + 8])
    position = _position_variance(x, P, motion, whole[INVARIANT] != 0)
    return heading > float(real[MAX_HEADING_VARIANCE]) or position > float(real[MAX_POSITION_VARIANCE])


@jit()
def _observe(
    begin: int, end: int, landmark: Ints, z: Floats, R: Floats, own: NDArray[np.uint8], whole: Ints, real: Floats,
    x: Floats, P: Floats, ids: Ints, counts: Ints, motion: Floats, slot_of: NDArray[np.int32], scratch: Floats,
    nis: Floats, status: NDArray[np.uint8],
) -> None:  # fmt: skip
    """Predict with the pending increment, then take one step's observations in turn."""
    u, a, b = scratch[0], scratch[1], scratch[2]
    mount = real[MOUNT : MOUNT + 4]
    model, invariant = whole[MODEL], whole[INVARIANT] != 0
    observed = 0
    has_u = predict(x, P, counts[DIM], motion, whole[INVARIANT], u)
    for o in range(begin, end):
        n = counts[DIM]
        slot = slot_of[landmark[o]]
        Ro = R[o if R.shape[0] > 1 else 0]
        if own[o] != 0:
            if has_u:
                add_rank_one(P, n, u)
                has_u = False
            if slot < 0 and augment(x, P, n, CARTESIAN, real[BODY : BODY + 4], 0.0, 0.0, Ro, invariant):
                slot_of[landmark[o]] = n
                ids[(n - 3) // 2] = landmark[o]
                counts[DIM] = n + 2
            continue
        observed = 1
        if slot >= 0:
            status[o], nis[o] = update(
                x, P, n, slot, model, mount, z[0, o], z[1, o], Ro, real[GATE], real[FLAG], invariant, u, has_u, a, b
            )
            if status[o] == GATED or status[o] == SINGULAR:
                counts[REJECTED] += 1
                continue
            has_u = False
            motion[NIS_SUM] += nis[o]
            motion[NIS_COUNT] += 1.0
        else:
            if has_u:
                add_rank_one(P, n, u)
                has_u = False
            nis[o] = math.nan
            if not augment(x, P, n, model, mount, z[0, o], z[1, o], Ro, invariant):
                status[o] = SINGULAR
                counts[REJECTED] += 1
                continue
            status[o] = FIRST
            slot_of[landmark[o]] = n
            ids[(n - 3) // 2] = landmark[o]
            counts[DIM] = n + 2
        counts[OBSERVATIONS] += 1
    if has_u:
        add_rank_one(P, counts[DIM], u)
    counts[OBSERVED] += observed


@jit(
    "UniTuple(int64, 2)(int64, boolean, float64[:, ::1], float64[:, :, ::1], int64[::1], int64[::1], int64[::1],"
    "float64[:, ::1], float64[:, :, ::1], uint8[::1], int64[::1], float64[::1], float64[::1], float64[:, ::1],"
    "int64[::1], int64[::1], float64[::1], int32[::1], float64[:, ::1], float64[::1], uint8[::1], float64[:, ::1],"
    "int32[::1], int64[:, ::1], float64[::1], int64[::1], int64[::1])",
    unlocked=True,
)
def walk(
    step: int, resumed: bool, increments: Floats, noises: Floats, control_step: Ints, observation_step: Ints,
    landmark: Ints, z: Floats, R: Floats, own: NDArray[np.uint8], whole: Ints, real: Floats, x: Floats, P: Floats,
    ids: Ints, counts: Ints, motion: Floats, slot_of: NDArray[np.int32], scratch: Floats, nis: Floats,
    status: NDArray[np.uint8], track: Floats, chapter: NDArray[np.int32],
    shelf_whole: Ints, shelf_reals: Floats, shelf_ids: Ints, fill: Ints,
) -> tuple[int, int]:  # fmt: skip
    """Apply the steps from ``step`` on to the active sub-map and those that follow it; (event, step).

    ``resumed`` says that the first step's control has been taken already. ``R`` holds one
    covariance for all observations or one for each. Where ``own`` is not 0, an observation marks the
    robot's own position, for another robot saw it there; where it is 2, the step is there for marks
    alone. Writes each observation's ``status`` and ``nis``, and for each step the pose after it in
    ``track`` and, in ``chapter``, how many sub-maps had been put on the shelf (``filtering.closing``)
    before. Events: DONE; GENESIS, where the shelf has no room for a sub-map that must close before
    this step's observations; GROW, where the state's arrays are too small for them.
    """
    noise = motion[NOISE : NOISE + 9].reshape(3, 3)
    c = int(np.searchsorted(control_step, step + (1 if resumed else 0)))
    i = int(np.searchsorted(observation_step, step))
    while step < track.shape[0]:
        if not resumed and c < control_step.shape[0] and control_step[c] == step:
            accumulate(motion[:3], noise, increments[c], noises[c])
            c += 1
        resumed = False
        end, marked = i, False
        while end < observation_step.shape[0] and observation_step[end] == step:
            end += 1
        if end > i:
            new = _new_landmarks(landmark, slot_of, i, end)
            if _wants_genesis(new, x, P, counts, motion, whole, real):
                if not close(
                    step, x, P, ids, counts, motion, whole[INVARIANT], slot_of, scratch,
                    shelf_whole, shelf_reals, shelf_ids, fill,
                ):  # fmt: skip
                    return GENESIS, step
                new = _new_landmarks(landmark, slot_of, i, end)
            if counts[DIM] + 2 * new > P.shape[0]:
                return GROW, step
            marked = own[i] == 2
            _observe(i, end, landmark, z, R, own, whole, real, x, P, ids, counts, motion, slot_of, scratch, nis, status)
            i = end
        counts[STEPS] += not marked
        sine, cosine = sincos(x[2])
        track[step, 0] = x[0] + cosine * motion[0] - sine * motion[1]
        track[step, 1] = x[1] + sine * motion[0] + cosine * motion[1]
        track[step, 2] = wrap(x[2] + motion[2])
        chapter[step] = fill[CLOSED]
        step += 1
    return DONE, step
