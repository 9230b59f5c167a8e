"""Cartesian: a landmark's coordinates in the sensor's frame, in two dimensions or three."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit

Floats = NDArray[np.float64]


@jit()
def predict(s: Floats, h: Floats, J: Floats) -> None:
    """z = s (m) of a point s in the sensor's frame, and dz/ds = I."""
    for i in range(s.shape[0]):
        h[i] = s[i]
        for j in range(s.shape[0]):
            J[i, j] = 1.0 if i == j else 0.0


@jit()
def invert(z: Floats, s: Floats, J: Floats) -> None:
    """s = z (m), and ds/dz = I."""
    for i in range(s.shape[0]):
        s[i] = z[i]
        for j in range(s.shape[0]):
            J[i, j] = 1.0 if i == j else 0.0
