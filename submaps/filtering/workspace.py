"""Where things stand in the scratch numbers that one walk works with: one flat array, so that passing it costs
nothing. Matrices are row by row, as wide as there are dimensions unless said.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit

Floats = NDArray[np.float64]

MOST_CHANNELS = 4
ROTATION = 0  # (dim, dim) of the pose
JACOBIAN = ROTATION + 9  # (dim, dim) V of a retraction
OFFSET = JACOBIAN + 9  # (dim,) from the robot to the landmark
POINT = OFFSET + 3  # (dim,) the landmark in the body frame
SEEN = POINT + 3  # (dim,) the landmark in the sensor's frame
PREDICTED = SEEN + 3  # (channels,) h(y)
INNOVATION = PREDICTED + 4  # (channels,)
SLOPE = INNOVATION + 4  # (channels, dim) dh/dy
INNER = SLOPE + 12  # (channels, dim) dh/ds
NOISE = INNER + 12  # (dim, dim) of what remains after the reduction to dim rows
READING_NOISE = NOISE + 9  # (4, 4) of a reading, with the prior of what it leaves open; or its Cholesky factor
SPREAD = READING_NOISE + 16  # (dim, 4) slope of a point by what it follows from
CARRIED = SPREAD + 12  # (dim, 4)
GAIN = CARRIED + 12  # (dim, dim) dh/dy R^T
TURNING = GAIN + 9  # (dim, rot) by the rotation, on the standard error
INNOVATION_COVARIANCE = TURNING + 9  # (dim, dim) or its Cholesky factor
STEP = INNOVATION_COVARIANCE + 9  # (pose,) a correction
READING = STEP + 6  # (channels,) z
SIZE = READING + 4


@jit()
def workspace() -> Floats:
    """Room for one walk."""
    return np.zeros(SIZE)
