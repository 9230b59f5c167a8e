"""Bearing only: a new landmark's range comes from a prior, and with it the point that a reading shows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.geometry.trig import arctan2

Floats = NDArray[np.float64]


@jit()
def predict(s: Floats, h: Floats, J: Floats) -> None:
    """z = atan2(s_y, s_x) (rad) of a point s (m) in the sensor's frame, and dz/ds."""
    squared = s[0] * s[0] + s[1] * s[1]
    h[0] = arctan2(s[1], s[0])
    J[0, 0], J[0, 1] = -s[1] / squared, s[0] / squared
