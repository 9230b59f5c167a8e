"""The readings that a state predicts of its landmarks: in the plane and in space, for either filter's error."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.association.candidates import Readings
from submaps.filtering.workspace import POINT, PREDICTED, SLOPE, workspace
from submaps.geometry import so3
from submaps.geometry.space import Key, Space
from submaps.geometry.trig import sincos
from submaps.observation.models import BEARING, RANGE_BEARING, predict

Floats = NDArray[np.float64]


def predicted_readings(
    space: Space, x: Floats, P: Floats, landmarks: int, model: int, sensor: Floats, channels: int, invariant: bool,
    carried: int = 0,
) -> Readings:  # fmt: skip
    """Readings of the landmarks of a state x = (position, rotation, l_1, ...), at least that long.

    ``P`` is the covariance of the filter's error (``filtering.kernel``), ``sensor`` as ``observation.models``
    has it, ``channels`` how many numbers a reading has. The errors of the last ``carried`` landmarks are
    additive, whatever the filter's are.
    """
    h, H = np.empty((landmarks, channels)), np.empty((landmarks, channels, space.pose + space.dim))
    _predict_readings(space.key, x, carried, model, sensor, invariant, h, H)
    own = space.pose + space.dim * np.arange(landmarks)[:, np.newaxis] + np.arange(space.dim)
    entries = np.concatenate([np.tile(np.arange(space.pose), (landmarks, 1)), own], axis=1)
    angular = np.zeros(channels, dtype=np.uint8)
    angular[-1] = model in (RANGE_BEARING, BEARING)
    return Readings(h, H, entries, P, angular)


_TYPES = "float64[::1], int64, int64, float64[::1], boolean, float64[:, ::1], float64[:, :, ::1])"


@jit("void(UniTuple(int64, 2), " + _TYPES, "void(UniTuple(int64, 3), " + _TYPES)
def _predict_readings(
    space: Key, x: Floats, carried: int, model: int, sensor: Floats, invariant: bool, h: Floats, H: Floats
) -> None:
    """h(y) with y = R^T (l - p), and H = dh/dy R^T [-I, -turn(q), I] on position, rotation and landmark.

    q is l - p where errors are additive. The invariant ones have turned with the rotation, the landmark's
    as the pose's, so q = 0; where the landmark's is additive and the pose's is not, q = l.
    """
    dim, pose = len(space), 3 * len(space) - 3
    w, R, d, q = workspace(), np.empty((dim, dim)), np.empty(dim), np.zeros(dim)
    if len(space) == 2:
        s, c = sincos(x[2])
        R[0, 0], R[0, 1], R[1, 0], R[1, 1] = c, -s, s, c
    else:
        so3.matrix(x[3], x[4], x[5], R)
    for landmark in range(h.shape[0]):
        k = pose + dim * landmark
        own = landmark < h.shape[0] - carried
        for i in range(dim):
            d[i] = x[k + i] - x[i]
            if not invariant:
                q[i] = d[i]
            elif not own:
                q[i] = x[k + i]
        for i in range(dim):
            w[POINT + i] = 0.0
            for j in range(dim):
                w[POINT + i] += R[j, i] * d[j]
        predict(space, model, sensor, 0, w)
        for a in range(h.shape[1]):
            row = H[landmark, a]
            h[landmark, a] = w[PREDICTED + a]
            for j in range(dim):
                g = 0.0
                for i in range(dim):
                    g += w[SLOPE + dim * a + i] * R[j, i]
                row[j], row[pose + j] = -g, g
            if len(space) == 2:
                row[2] = row[3] * q[1] - row[4] * q[0]
            else:
                row[3] = row[7] * q[2] - row[8] * q[1]
                row[4] = row[8] * q[0] - row[6] * q[2]
                row[5] = row[6] * q[1] - row[7] * q[0]
