"""Range and bearing of a landmark from the sensor."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.geometry.trig import arctan2, sincos

Floats = NDArray[np.float64]


@jit()
def predict(s: Floats, h: Floats, J: Floats) -> None:
    """z = (|s| m, atan2(s_y, s_x) rad) of a point s (m) in the sensor's frame, and dz/ds.

    Not finite at s = 0, where a bearing means nothing; the kernel reports that as singular.
    """
    squared = s[0] * s[0] + s[1] * s[1]
    distance = math.sqrt(squared)
    h[0], h[1] = distance, arctan2(s[1], s[0])
    J[0, 0], J[0, 1] = s[0] / distance, s[1] / distance
    J[1, 0], J[1, 1] = -s[1] / squared, s[0] / squared


@jit()
def invert(r: float, b: float, s: Floats, J: Floats) -> None:
    """s = (r cos b, r sin b) (m) of a range (m) and a bearing (rad), and ds/d(r, b).

    The lecture's inverse observation model with its sine and cosine in their proper places.
    """
    sine, cosine = sincos(b)
    s[0], s[1] = r * cosine, r * sine
    J[0, 0], J[0, 1] = cosine, -r * sine
    J[1, 0], J[1, 1] = sine, r * cosine
