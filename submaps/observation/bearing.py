"""Bearing only: a new landmark's range comes from a prior, and with it the point that a reading shows."""

from __future__ import annotations

from submaps._jit import jit
from submaps.geometry.trig import arctan2


@jit()
def predict(x: float, y: float) -> tuple[float, float, float]:
    """z = atan2(s_y, s_x) (rad) of a point s = (x, y) m in the sensor's frame, and dz/ds."""
    squared = x * x + y * y
    return arctan2(y, x), -y / squared, x / squared
