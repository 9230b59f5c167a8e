"""Pinhole: pixels of one calibrated camera; a new landmark's depth comes from a prior.

The sensor's z axis looks ahead. ``camera`` is (fu, fv, cu, cv), pixels.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit

Floats = NDArray[np.float64]


@jit()
def predict(s: Floats, camera: Floats, h: Floats, J: Floats) -> None:
    """z = (fu x/z + cu, fv y/z + cv) of a point s (m) in the sensor's frame, and dz/ds.

    Not a number behind the camera; the kernel reports that as singular.
    """
    inverse = 1.0 / s[2] if s[2] > 0.0 else math.nan
    x, y = s[0] * inverse, s[1] * inverse
    h[0], h[1] = camera[0] * x + camera[2], camera[1] * y + camera[3]
    J[0, 0], J[0, 1], J[0, 2] = camera[0] * inverse, 0.0, -camera[0] * x * inverse
    J[1, 0], J[1, 1], J[1, 2] = 0.0, camera[1] * inverse, -camera[1] * y * inverse


@jit()
def invert(u: float, v: float, depth: float, camera: Floats, s: Floats, J: Floats) -> None:
    """s = d ((u - cu)/fu, (v - cv)/fv, 1) (m) of pixels and a depth d (m), and ds/d(u, v, d)."""
    x, y = (u - camera[2]) / camera[0], (v - camera[3]) / camera[1]
    s[0], s[1], s[2] = depth * x, depth * y, depth
    J[:, :3] = 0.0
    J[0, 0], J[1, 1] = depth / camera[0], depth / camera[1]
    J[0, 2], J[1, 2], J[2, 2] = x, y, 1.0
