"""Range and bearing of a landmark from the sensor."""

from __future__ import annotations

import math

from submaps._jit import jit
from submaps.geometry.trig import arctan2, sincos

Six = tuple[float, float, float, float, float, float]


@jit()
def predict(x: float, y: float) -> Six:
    """z = (|s| m, atan2(s_y, s_x) rad) of a point s = (x, y) m in the sensor's frame, and dz/ds row by row.

    Not finite at s = 0, where a bearing means nothing; the kernel reports that as singular.
    """
    squared = x * x + y * y
    distance = math.sqrt(squared)
    return distance, arctan2(y, x), x / distance, y / distance, -y / squared, x / squared


@jit()
def invert(r: float, b: float) -> Six:
    """s = (r cos b, r sin b) (m) of a range (m) and a bearing (rad), and ds/d(r, b) row by row.

    The lecture's inverse observation model with its sine and cosine in their proper places.
    """
    sine, cosine = sincos(b)
    return r * cosine, r * sine, cosine, -r * sine, sine, r * cosine
