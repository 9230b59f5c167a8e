"""Pinhole: pixels of one calibrated camera; a new landmark's depth comes from a prior.

The sensor's z axis looks ahead. Focal lengths and principal point in pixels.
"""

from __future__ import annotations

import math

from submaps._jit import jit

Eight = tuple[float, float, float, float, float, float, float, float]


@jit()
def predict(x: float, y: float, z: float, fu: float, fv: float, cu: float, cv: float) -> Eight:
    """(fu x/z + cu, fv y/z + cv) of a point (x, y, z) m in the sensor's frame, and its slope row by row.

    Not a number behind the camera; the kernel reports that as singular.
    """
    inverse = 1.0 / z if z > 0.0 else math.nan
    u, v = fu * x * inverse, fv * y * inverse
    return u + cu, v + cv, fu * inverse, 0.0, -u * inverse, 0.0, fv * inverse, -v * inverse


@jit()
def invert(u: float, v: float, fu: float, fv: float, cu: float, cv: float) -> tuple[float, float]:
    """The ray (x/z, y/z) of a pixel: a point is depth times (x/z, y/z, 1)."""
    return (u - cu) / fu, (v - cv) / fv
