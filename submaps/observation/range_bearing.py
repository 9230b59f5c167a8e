"""Range and bearing of a landmark from the sensor."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.geometry.trig import arctan2, sincos

Floats = NDArray[np.float64]


@jit()
def predict(y0: float, y1: float, mount: Floats) -> tuple[float, float, float, float, float, float]:
    """z = (|s| m, atan2(s_y, s_x) rad) with s = R_m^T (y - m), and dz/dy (2, 2) row by row.

    Not finite at s = 0, where a bearing means nothing; the kernel reports that as singular.
    """
    c, s = mount[2], mount[3]
    d0, d1 = y0 - mount[0], y1 - mount[1]
    squared = d0 * d0 + d1 * d1
    distance = math.sqrt(squared)
    bearing = arctan2(-s * d0 + c * d1, c * d0 + s * d1)
    return distance, bearing, d0 / distance, d1 / distance, -d1 / squared, d0 / squared


@jit()
def invert(z0: float, z1: float, mount: Floats) -> tuple[float, float, float, float, float, float]:
    """y = R_m (r cos b, r sin b) + m (m), and dy/dz (2, 2) row by row.

    The lecture's inverse observation model with its sine and cosine in their proper places.
    """
    s, c = sincos(z1)
    u0 = mount[2] * c - mount[3] * s
    u1 = mount[3] * c + mount[2] * s
    return mount[0] + z0 * u0, mount[1] + z0 * u1, u0, -z0 * u1, u1, z0 * u0
