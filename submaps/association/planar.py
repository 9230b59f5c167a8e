"""The readings that a planar state predicts of its landmarks, for either filter's error."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.association.candidates import Readings
from submaps.geometry.trig import sincos
from submaps.observation.models import RANGE_BEARING, predict

Floats = NDArray[np.float64]


def planar(
    x: Floats, P: Floats, landmarks: int, model: int, mount: Floats, invariant: bool, carried: int = 0
) -> Readings:
    """Readings of the landmarks of a state (p_x, p_y, theta, l_1x, ...) of at least 3 + 2 ``landmarks`` entries.

    ``P`` is the covariance of the filter's error, as ``filtering.kernel`` keeps it; ``mount`` is
    (x m, y m, cos, sin) of the sensor in the body. The errors of the last ``carried`` landmarks are
    additive, whatever the filter's are.
    """
    h, H = np.empty((landmarks, 2)), np.empty((landmarks, 2, 5))
    _planar(x, landmarks, carried, model, mount, invariant, h, H)
    own = 3 + 2 * np.arange(landmarks)[:, np.newaxis] + np.arange(2)
    entries = np.concatenate([np.broadcast_to(np.arange(3), (landmarks, 3)), own], axis=1)
    angular = np.array([0, model == RANGE_BEARING], dtype=np.uint8)
    return Readings(h, H, entries, P, angular)


@jit("void(float64[::1], int64, int64, int64, float64[::1], boolean, float64[:, ::1], float64[:, :, ::1])")
def _planar(
    x: Floats, landmarks: int, carried: int, model: int, mount: Floats, invariant: bool, h: Floats, H: Floats
) -> None:
    """h(y) with y = R^T (l - p), and H = dh/dy R^T [-I, -J q, I] on p, theta and l.

    q is l - p where errors are additive. The invariant ones have turned by theta with the landmark, so
    q = 0; where the landmark's own is additive and the pose's is not, q = l.
    """
    s, c = sincos(x[2])
    for j in range(landmarks):
        k = 3 + 2 * j
        d0, d1 = x[k] - x[0], x[k + 1] - x[1]
        h[j, 0], h[j, 1], h00, h01, h10, h11 = predict(model, c * d0 + s * d1, -s * d0 + c * d1, mount)
        q0, q1 = d0, d1
        if invariant:
            own = j < landmarks - carried
            q0, q1 = (0.0, 0.0) if own else (x[k], x[k + 1])
        for r in range(2):
            along, across = (h00, h01) if r == 0 else (h10, h11)
            g0, g1 = along * c - across * s, along * s + across * c
            H[j, r, 0], H[j, r, 1] = -g0, -g1
            H[j, r, 2] = g0 * q1 - g1 * q0
            H[j, r, 3], H[j, r, 4] = g0, g1
