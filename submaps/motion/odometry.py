"""Odometry: a control is the body-frame increment itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit

Floats = NDArray[np.float64]


@jit()
def increment(control: Floats, covariance: Floats, out: Floats, out_covariance: Floats) -> None:
    """Increment (dx m, dy m, dtheta rad) of one reading, with its covariance (3, 3).

    The pose moves by p + R(theta)(dx, dy), theta + dtheta; the noise is additive in the body frame.
    """
    for i in range(3):
        out[i] = control[i]
        for j in range(3):
            out_covariance[i, j] = covariance[i, j]
