"""Small arrays that one walk works with, made once for all of its observations."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.geometry.space import Key

Floats = NDArray[np.float64]
MOST_CHANNELS = 4
# (1e-4 m)^2: keeps a pose and a mark at the same place from being the same number twice.
MARK_VARIANCE = 1e-8


class Workspace(NamedTuple):
    """Named by what they hold; ``d`` dimensions, ``c`` channels at most, ``r`` numbers of rotation."""

    rotation: Floats  # (d, d) of the pose
    jacobian: Floats  # (d, d) V of a retraction
    offset: Floats  # (d,) from the robot to the landmark
    point: Floats  # (d,) the landmark in the body frame
    seen: Floats  # (d,) the landmark in the sensor's frame
    reading: Floats  # (c,) z
    predicted: Floats  # (c,) h(y)
    slope: Floats  # (c, d) dh/dy
    inner: Floats  # (c, d) dh/ds
    innovation: Floats  # (c,)
    noise: Floats  # (d, d) of what remains after the reduction to d rows
    whitened: Floats  # (c, c)
    spread: Floats  # (d, c) slope of a point by what it follows from
    carried: Floats  # (d, c)
    gain: Floats  # (d, d) dh/dy R^T
    turning: Floats  # (d, r) by the rotation, on the standard error
    S: Floats  # (d, d)
    nothing: Floats  # (c,) zeros: the reading of a robot that marks its own position
    mark: Floats  # (d, d) its covariance
    step: Floats  # (d + r,) a correction
    pose: Floats  # (d + r, d + r)
    more: Floats  # (d + r, d + r)


@jit()
def workspace(space: Key) -> Workspace:
    """Room for one walk."""
    dim, rot = len(space), 2 * len(space) - 3
    pose, most = dim + rot, MOST_CHANNELS
    return Workspace(
        np.empty((dim, dim)),
        np.empty((dim, dim)),
        np.empty(dim),
        np.empty(dim),
        np.empty(dim),
        np.empty(most),
        np.empty(most),
        np.empty((most, dim)),
        np.empty((most, dim)),
        np.empty(most),
        np.empty((dim, dim)),
        np.empty((most, most)),
        np.empty((dim, most)),
        np.empty((dim, most)),
        np.empty((dim, dim)),
        np.empty((dim, rot)),
        np.empty((dim, dim)),
        np.zeros(most),
        MARK_VARIANCE * np.eye(dim),
        np.empty(pose),
        np.empty((pose, pose)),
        np.empty((pose, pose)),
    )
