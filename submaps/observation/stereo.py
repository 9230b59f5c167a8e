"""Stereo: pixels of one point in two calibrated cameras side by side.

The left camera is the sensor: z ahead, x to the right, y down; the right one lies ``b`` m along x. ``camera``
is (fu, fv, cu, cv) in pixels and b.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit

Floats = NDArray[np.float64]


@jit()
def predict(s: Floats, camera: Floats, h: Floats, J: Floats) -> None:
    """z = (fu x/z + cu, fv y/z + cv, fu (x - b)/z + cu, fv y/z + cv) of a point s (m), and dz/ds.

    Not a number behind the cameras; the kernel reports that as singular.
    """
    inverse = 1.0 / s[2] if s[2] > 0.0 else math.nan
    x, y, right = s[0] * inverse, s[1] * inverse, (s[0] - camera[4]) * inverse
    h[0], h[1], h[2] = camera[0] * x + camera[2], camera[1] * y + camera[3], camera[0] * right + camera[2]
    h[3] = h[1]
    J[0, 0], J[0, 1], J[0, 2] = camera[0] * inverse, 0.0, -camera[0] * x * inverse
    J[1, 0], J[1, 1], J[1, 2] = 0.0, camera[1] * inverse, -camera[1] * y * inverse
    J[2, 0], J[2, 1], J[2, 2] = camera[0] * inverse, 0.0, -camera[0] * right * inverse
    J[3, 0], J[3, 1], J[3, 2] = J[1, 0], J[1, 1], J[1, 2]


@jit()
def invert(z: Floats, camera: Floats, s: Floats, J: Floats) -> None:
    """s = b/(u_l - u_r) (u_l - cu, fu/fv (v - cv), fu) (m) with v the mean of both rows, and ds/dz.

    The lecture's depth from a correspondence, for cameras side by side. Not a number where the disparity
    is not above 0, which the kernel reports as singular.
    """
    disparity = z[0] - z[2]
    k = camera[4] / disparity if 0.0 < disparity < math.inf else math.nan
    ratio = camera[0] / camera[1]
    left, row = z[0] - camera[2], ratio * (0.5 * (z[1] + z[3]) - camera[3])
    s[0], s[1], s[2] = k * left, k * row, k * camera[0]
    by_disparity = -k / disparity
    J[0, 0], J[0, 1], J[0, 2], J[0, 3] = k + by_disparity * left, 0.0, -by_disparity * left, 0.0
    J[1, 0], J[1, 1], J[1, 2], J[1, 3] = by_disparity * row, 0.5 * k * ratio, -by_disparity * row, 0.5 * k * ratio
    J[2, 0], J[2, 1], J[2, 2], J[2, 3] = by_disparity * camera[0], 0.0, -by_disparity * camera[0], 0.0
