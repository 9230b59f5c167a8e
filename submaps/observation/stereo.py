"""Stereo: pixels of one point in two calibrated cameras side by side.

The left camera is the sensor: z ahead, x to the right, y down; the right one lies ``b`` m along x. Focal
lengths and principal point in pixels.
"""

from __future__ import annotations

import math

from submaps._jit import jit

Eight = tuple[float, float, float, float, float, float, float, float]
Seven = tuple[float, float, float, float, float, float, float]


@jit()
def predict(x: float, y: float, z: float, fu: float, fv: float, cu: float, cv: float, b: float) -> Eight:
    """(fu x/z + cu, fv y/z + cv, fu (x - b)/z + cu) of a point (x, y, z) m: u and v left, u right; v right is v left.

    After them the slopes du/dx, dv/dy, du/dz, dv/dz and that of u right by z; du_right/dx is du/dx. Not a number
    behind the cameras; the kernel reports that as singular.
    """
    inverse = 1.0 / z if z > 0.0 else math.nan
    u, v, right = fu * x * inverse, fv * y * inverse, fu * (x - b) * inverse
    return u + cu, v + cv, right + cu, fu * inverse, fv * inverse, -u * inverse, -v * inverse, -right * inverse


@jit()
def invert(u: float, v: float, right: float, fu: float, fv: float, cu: float, cv: float, b: float) -> Seven:
    """The point b/(u - u_right) (u - cu, fu/fv (v - cv), fu) (m), v the mean of both rows.

    The lecture's depth from a correspondence, for cameras side by side. After it the slopes of x, y and z by u
    (that by u_right is the opposite, but for x's own), and that of y by v. Not a number where the disparity is
    not above 0, which the kernel reports as singular.
    """
    disparity = u - right
    k = b / disparity if 0.0 < disparity < math.inf else math.nan
    along, ratio = -k / disparity, fu / fv
    row = ratio * (v - cv)
    return k * (u - cu), k * row, k * fu, along * (u - cu), along * row, along * fu, k * ratio
