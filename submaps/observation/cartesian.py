"""Cartesian: a landmark's coordinates in the sensor's frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit

Floats = NDArray[np.float64]


@jit()
def predict(y0: float, y1: float, mount: Floats) -> tuple[float, float, float, float, float, float]:
    """z = R_m^T (y - m) of a body-frame point y (m), and dz/dy (2, 2) row by row.

    ``mount`` is (x m, y m, cos, sin) of the sensor in the body.
    """
    c, s = mount[2], mount[3]
    d0, d1 = y0 - mount[0], y1 - mount[1]
    return c * d0 + s * d1, -s * d0 + c * d1, c, s, -s, c


@jit()
def invert(z0: float, z1: float, mount: Floats) -> tuple[float, float, float, float, float, float]:
    """y = R_m z + m, the body-frame point (m) that a reading shows, and dy/dz (2, 2) row by row."""
    c, s = mount[2], mount[3]
    return mount[0] + c * z0 - s * z1, mount[1] + s * z0 + c * z1, c, -s, s, c
