"""The compiled walk over a batch's columns; it comes back to Python only for rare events."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.filtering.closing import CLOSED, close
from submaps.filtering.genesis import wants_genesis
from submaps.filtering.kernel import FIRST, GATED, LOST, SINGULAR, augment, retract_held, update
from submaps.filtering.layout import (
    DIM,
    DONE,
    FLAG,
    GATE,
    GENESIS,
    GROW,
    INVARIANT,
    MODEL,
    MOTIONLESS,
    NIS_COUNT,
    NIS_SUM,
    OBSERVATIONS,
    OBSERVED,
    REJECTED,
    SENSOR,
    STEPS,
)
from submaps.filtering.passes import add
from submaps.filtering.predicting import accumulate, accumulate_in_space, pending_of, predict
from submaps.filtering.relocating import LEAST_KNOWN, relocalise
from submaps.filtering.workspace import READING, workspace
from submaps.geometry import so3
from submaps.geometry.space import Key
from submaps.geometry.trig import sincos, wrap
from submaps.observation.models import CARTESIAN, sensor_size

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# (1e-4 m)^2: keeps a pose and a mark at the same place from being the same number twice.
_MARK_VARIANCE = 1e-8

_quaternion, _multiply, _rotation_vector = so3.quaternion, so3.multiply, so3.rotation_vector
_entries = so3.entries


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
def _observe(
    space: Key, begin: int, end: int, landmark: Ints, z: Floats, R: Floats, own: NDArray[np.uint8], whole: Ints,
    real: Floats, x: Floats, P: Floats, ids: Ints, counts: Ints, motion: Floats, slot_of: NDArray[np.int32],
    scratch: Floats, nis: Floats, status: NDArray[np.uint8], w: Floats,
) -> None:  # fmt: skip
    """Predict with the pending increment, then take one step's observations in turn."""
    dim, pose = len(space), 3 * len(space) - 3
    U, A = scratch[: pose - dim], scratch[pose - dim : pose]
    body = SENSOR + sensor_size(dim)
    model, invariant = whole[MODEL], whole[INVARIANT] != 0
    observed = 0
    has_u = predict(space, x, P, counts[DIM], motion, whole[INVARIANT], U)
    # Where each pose is found from what is seen, known landmarks come first, all of them at one state, and
    # new ones are placed by them.
    before = counts[DIM]
    passes = 2 if whole[MOTIONLESS] != 0 and before > pose else 1
    held = np.zeros(before if passes == 2 else 1)
    for take in range(passes):
        hold = passes == 2 and take == 0
        for o in range(begin, end):
            n = counts[DIM]
            slot = slot_of[landmark[o]]
            if passes == 2 and (take == 0) != (0 <= slot < before):
                continue
            Ro = R[o if R.shape[0] > 1 else 0]
            if own[o] != 0:
                if has_u:
                    add(space, P, n, U)
                    has_u = False
                nothing, mark = np.zeros(dim), _MARK_VARIANCE * np.eye(dim)
                if slot < 0 and augment(space, x, P, n, CARTESIAN, real, body, nothing, 0, mark, invariant, w):
                    slot_of[landmark[o]] = n
                    ids[(n - pose) // dim] = landmark[o]
                    counts[DIM] = n + dim
                continue
            observed = 1
            for c in range(z.shape[0]):
                w[READING + c] = z[c, o]
            if slot >= 0:
                status[o], nis[o] = update(
                    space, x, P, n, slot, model, real, SENSOR, w, READING, Ro, real[GATE], real[FLAG], invariant,
                    U, has_u, A, hold, held, w,
                )  # fmt: skip
                if status[o] == GATED or status[o] == SINGULAR:
                    counts[REJECTED] += 1
                    continue
                has_u = False
                motion[NIS_SUM] += nis[o]
                motion[NIS_COUNT] += 1.0
            else:
                if has_u:
                    add(space, P, n, U)
                    has_u = False
                nis[o] = math.nan
                if not augment(space, x, P, n, model, real, SENSOR, w, READING, Ro, invariant, w):
                    status[o] = SINGULAR
                    counts[REJECTED] += 1
                    continue
                status[o] = FIRST
                slot_of[landmark[o]] = n
                ids[(n - pose) // dim] = landmark[o]
                counts[DIM] = n + dim
            counts[OBSERVATIONS] += 1
        if hold:
            retract_held(space, x, before, held, A, invariant, w)
    if has_u:
        add(space, P, counts[DIM], U)
    counts[OBSERVED] += observed


@jit()
def _located(
    space: Key, begin: int, end: int, landmark: Ints, z: Floats, R: Floats, whole: Ints, real: Floats, x: Floats,
    P: Floats, counts: Ints, slot_of: NDArray[np.int32], w: Floats,
) -> bool:  # fmt: skip
    """Whether the robot's pose is known before a step's observations; without motion, they have to say it.

    A map begins where enough landmarks are seen at once for others to be found by them.
    """
    if len(space) == 2 or whole[MOTIONLESS] == 0:
        return True
    if counts[DIM] == 6:
        return end - begin >= LEAST_KNOWN
    return relocalise(
        space, x, P, counts[DIM], whole[INVARIANT] != 0, begin, end, landmark, z, R, whole[MODEL], real, slot_of, w
    )


@jit()
def _present(space: Key, x: Floats, pending: Floats, out: Floats) -> None:
    """The pose with the pending increment composed onto it, into ``out`` (pose,)."""
    if len(space) == 2:
        sine, cosine = sincos(x[2])
        out[0] = x[0] + cosine * pending[0] - sine * pending[1]
        out[1] = x[1] + sine * pending[0] + cosine * pending[1]
        out[2] = wrap(x[2] + pending[2])
    else:
        R = _entries(x[3], x[4], x[5])
        for i in range(3):
            out[i] = x[i]
            for j in range(3):
                out[i] += R[3 * i + j] * pending[j]
        turned = _quaternion(pending[3], pending[4], pending[5])
        out[3], out[4], out[5] = _rotation_vector(_multiply(_quaternion(x[3], x[4], x[5]), turned))


_TYPES = (
    "int64, boolean, float64[:, ::1], float64[:, :, ::1], int64[::1], int64[::1], int64[::1],"
    "float64[:, ::1], float64[:, :, ::1], uint8[::1], int64[::1], float64[::1], float64[::1], float64[:, ::1],"
    "int64[::1], int64[::1], float64[::1], int32[::1], float64[:, ::1], float64[::1], uint8[::1], float64[:, ::1],"
    "int32[::1], int64[:, ::1], float64[::1], int64[::1], int64[::1])"
)


@jit(
    "UniTuple(int64, 2)(UniTuple(int64, 2), " + _TYPES,
    "UniTuple(int64, 2)(UniTuple(int64, 3), " + _TYPES,
    unlocked=True,
)
def walk(
    space: Key, step: int, resumed: bool, increments: Floats, noises: Floats, control_step: Ints,
    observation_step: Ints, landmark: Ints, z: Floats, R: Floats, own: NDArray[np.uint8], whole: Ints, real: Floats,
    x: Floats, P: Floats, ids: Ints, counts: Ints, motion: Floats, slot_of: NDArray[np.int32], scratch: Floats,
    nis: Floats, status: NDArray[np.uint8], track: Floats, chapter: NDArray[np.int32],
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
    dim = len(space)
    w = workspace()
    pending, noise = pending_of(space, motion)
    c = int(np.searchsorted(control_step, step + (1 if resumed else 0)))
    i = int(np.searchsorted(observation_step, step))
    while step < track.shape[0]:
        if not resumed and c < control_step.shape[0] and control_step[c] == step:
            if len(space) == 2:
                accumulate(pending, noise, increments[c], noises[c])
            else:
                accumulate_in_space(pending, noise, increments[c], noises[c])
            c += 1
        resumed = False
        end, marked = i, False
        while end < observation_step.shape[0] and observation_step[end] == step:
            end += 1
        if end > i and not _located(space, i, end, landmark, z, R, whole, real, x, P, counts, slot_of, w):
            nis[i:end] = math.nan
            status[i:end] = LOST
            counts[REJECTED] += end - i
            i = end
        if end > i:
            new = _new_landmarks(landmark, slot_of, i, end)
            if wants_genesis(space, new, x, P, counts, motion, whole, real):
                if not close(
                    space, step, x, P, ids, counts, motion, whole, slot_of, scratch,
                    shelf_whole, shelf_reals, shelf_ids, fill,
                ):  # fmt: skip
                    return GENESIS, step
                new = _new_landmarks(landmark, slot_of, i, end)
            if counts[DIM] + dim * new > P.shape[0]:
                return GROW, step
            marked = own[i] == 2
            _observe(
                space, i, end, landmark, z, R, own, whole, real, x, P, ids, counts, motion, slot_of, scratch,
                nis, status, w,
            )  # fmt: skip
            i = end
        counts[STEPS] += not marked
        _present(space, x, pending, track[step])
        chapter[step] = fill[CLOSED]
        step += 1
    return DONE, step
