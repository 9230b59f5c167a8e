"""The table of observation models that the compiled kernel chooses from."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.geometry.trig import wrap
from submaps.observation import cartesian, range_bearing

Floats = NDArray[np.float64]

_cartesian_predict, _cartesian_invert = cartesian.predict, cartesian.invert
_range_bearing_predict, _range_bearing_invert = range_bearing.predict, range_bearing.invert
CARTESIAN, RANGE_BEARING = 0, 1
MODELS = {"cartesian": CARTESIAN, "range_bearing": RANGE_BEARING}
_SIGNATURE = "UniTuple(float64, 6)(int64, float64, float64, float64[::1])"


@jit(_SIGNATURE)
def predict(model: int, y0: float, y1: float, mount: Floats) -> tuple[float, float, float, float, float, float]:
    """h(y) and dh/dy (row by row) of a body-frame point y (m); ``mount`` (x, y, cos, sin)."""
    if model == CARTESIAN:
        return _cartesian_predict(y0, y1, mount)
    return _range_bearing_predict(y0, y1, mount)


@jit(_SIGNATURE)
def invert(model: int, z0: float, z1: float, mount: Floats) -> tuple[float, float, float, float, float, float]:
    """The body-frame point y (m) that a reading shows, and dy/dz (row by row)."""
    if model == CARTESIAN:
        return _cartesian_invert(z0, z1, mount)
    return _range_bearing_invert(z0, z1, mount)


@jit("UniTuple(float64, 2)(int64, float64, float64, float64, float64)")
def innovation(model: int, z0: float, z1: float, h0: float, h1: float) -> tuple[float, float]:
    """z - h, with a bearing's difference wrapped to [-pi, pi)."""
    if model == RANGE_BEARING:
        return z0 - h0, wrap(z1 - h1)
    return z0 - h0, z1 - h1
