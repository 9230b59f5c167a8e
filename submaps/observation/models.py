"""The table of observation models that the compiled kernel chooses from.

A model knows the sensor's frame alone: h(s), dh/ds and the point that a reading shows. Here the sensor's mount
is added: s = R_m^T (y - m), with y the landmark in the body frame. A ``sensor`` is the mount's position (dim)
and rotation matrix (dim * dim, row by row), then fu, fv, cu, cv, baseline, and mean and sigma of a depth.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.config import ObservationConfig
from submaps.filtering.workspace import Workspace, workspace
from submaps.geometry import so3
from submaps.geometry.space import Key, Space
from submaps.geometry.trig import wrap
from submaps.observation import bearing, cartesian, pinhole, range_bearing, stereo

Floats = NDArray[np.float64]

_cartesian_predict, _cartesian_invert = cartesian.predict, cartesian.invert
_range_bearing_predict, _range_bearing_invert = range_bearing.predict, range_bearing.invert
_bearing_predict = bearing.predict
_stereo_predict, _stereo_invert = stereo.predict, stereo.invert
_pinhole_predict, _pinhole_invert = pinhole.predict, pinhole.invert
CARTESIAN, RANGE_BEARING, BEARING, STEREO, PINHOLE = 0, 1, 2, 3, 4
MODELS = {
    "cartesian": CARTESIAN, "cartesian3d": CARTESIAN, "range_bearing": RANGE_BEARING, "bearing": BEARING,
    "stereo": STEREO, "pinhole": PINHOLE,
}  # fmt: skip
_CAMERA, _DEPTH, _PARAMETERS = 0, 5, 7


def sensor_of(space: Space, config: ObservationConfig) -> Floats:
    """A sensor as the kernel takes it."""
    mount = config.mount
    if space.dim == 3:
        mount = (*mount[:3], *so3.rotation_vector((mount[3], mount[4], mount[5], mount[6])))
    camera, depth = config.camera, config.depth
    optics = (camera.fu, camera.fv, camera.cu, camera.cv, camera.baseline) if camera else (0.0,) * 5
    prior = (depth.mean, depth.sigma) if depth else (0.0, 0.0)
    return np.concatenate([mount[: space.dim], space.rotation(mount).ravel(), optics, prior])


def body_sensor(space: Space) -> Floats:
    """A Cartesian sensor that is the body itself."""
    return np.concatenate([np.zeros(space.dim), np.eye(space.dim).ravel(), np.zeros(_PARAMETERS)])


@jit()
def sensor_size(dim: int) -> int:
    """Length of a sensor."""
    return dim + dim * dim + _PARAMETERS


@jit()
def channels(space: Key, model: int) -> int:
    """How many numbers a reading has."""
    if model == CARTESIAN:
        return len(space)
    if model == BEARING:
        return 1
    return 4 if model == STEREO else 2


@jit()
def predict(space: Key, model: int, sensor: Floats, w: Workspace) -> None:
    """h(y) and dh/dy of the body-frame point ``w.point`` (m), into ``w.predicted`` and ``w.slope``."""
    dim = len(space)
    for i in range(dim):
        total = 0.0
        for j in range(dim):
            total += sensor[dim + j * dim + i] * (w.point[j] - sensor[j])
        w.seen[i] = total
    if model == CARTESIAN:
        _cartesian_predict(w.seen, w.predicted, w.inner)
    elif len(space) == 2:
        if model == RANGE_BEARING:
            _range_bearing_predict(w.seen, w.predicted, w.inner)
        else:
            _bearing_predict(w.seen, w.predicted, w.inner)
    else:
        camera = sensor[dim + dim * dim :]
        if model == STEREO:
            _stereo_predict(w.seen, camera, w.predicted, w.inner)
        else:
            _pinhole_predict(w.seen, camera, w.predicted, w.inner)
    for a in range(channels(space, model)):
        for j in range(dim):
            total = 0.0
            for i in range(dim):
                total += w.inner[a, i] * sensor[dim + j * dim + i]
            w.slope[a, j] = total


@jit()
def invert(space: Key, model: int, sensor: Floats, z: Floats, R: Floats, w: Workspace) -> int:
    """The body-frame point (m) that a reading shows, into ``w.point``; how many numbers it follows from.

    ``w.spread`` is its slope by those numbers, ``w.whitened`` their covariance: the reading's, and after it
    the prior of what a single reading leaves open.
    """
    dim = len(space)
    parameters, count = sensor[dim + dim * dim :], channels(space, model)
    depth, variance = parameters[_DEPTH], parameters[_DEPTH + 1] * parameters[_DEPTH + 1]
    for a in range(count):
        for b in range(count):
            w.whitened[a, b] = R[a, b]
    if model == CARTESIAN:
        _cartesian_invert(z, w.seen, w.carried)
    elif len(space) == 2:
        if model == BEARING:  # as a range, known by its prior, and a bearing
            count = 2
            w.whitened[1, 1], w.whitened[0, 0], w.whitened[0, 1], w.whitened[1, 0] = R[0, 0], variance, 0.0, 0.0
            _range_bearing_invert(depth, z[0], w.seen, w.carried)
        else:
            _range_bearing_invert(z[0], z[1], w.seen, w.carried)
    elif model == STEREO:
        _stereo_invert(z, parameters, w.seen, w.carried)
    else:
        count = 3
        w.whitened[2, :3], w.whitened[:3, 2], w.whitened[2, 2] = 0.0, 0.0, variance
        _pinhole_invert(z[0], z[1], depth, parameters, w.seen, w.carried)
    for i in range(dim):
        total = sensor[i]
        for j in range(dim):
            total += sensor[dim + i * dim + j] * w.seen[j]
        w.point[i] = total
    turn_columns(space, sensor[dim : dim + dim * dim].reshape(dim, dim), count, w.carried, w.spread)
    return count


@jit()
def turn_columns(space: Key, A: Floats, count: int, B: Floats, out: Floats) -> None:
    """out <- A B, of (dim, dim) and the first ``count`` columns of B."""
    dim = len(space)
    for i in range(dim):
        for b in range(count):
            total = 0.0
            for k in range(dim):
                total += A[i, k] * B[k, b]
            out[i, b] = total


@jit()
def innovate(space: Key, model: int, z: Floats, w: Workspace) -> None:
    """z - h into ``w.innovation``, with a bearing's difference wrapped to [-pi, pi)."""
    count = channels(space, model)
    for a in range(count):
        w.innovation[a] = z[a] - w.predicted[a]
    if model == RANGE_BEARING:
        w.innovation[1] = wrap(w.innovation[1])
    elif model == BEARING:
        w.innovation[0] = wrap(w.innovation[0])


@jit(
    "Tuple((float64[::1], float64[:, ::1]))(UniTuple(int64, 2), int64, float64[::1], float64[::1])",
    "Tuple((float64[::1], float64[:, ::1]))(UniTuple(int64, 3), int64, float64[::1], float64[::1])",
)
def reading(space: Key, model: int, sensor: Floats, y: Floats) -> tuple[Floats, Floats]:
    """h(y) (channels,) and dh/dy (channels, dim) of a body-frame point y (dim,), m."""
    w = workspace(space)
    count = channels(space, model)
    w.point[:] = y
    predict(space, model, sensor, w)
    return w.predicted[:count].copy(), w.slope[:count].copy()


@jit(
    "Tuple((float64[::1], float64[:, ::1]))(UniTuple(int64, 2), int64, float64[::1], float64[::1], float64[:, ::1])",
    "Tuple((float64[::1], float64[:, ::1]))(UniTuple(int64, 3), int64, float64[::1], float64[::1], float64[:, ::1])",
)
def shown(space: Key, model: int, sensor: Floats, z: Floats, R: Floats) -> tuple[Floats, Floats]:
    """The body-frame point (dim,), m, that a reading shows, and its covariance (dim, dim): a measurement inverted.

    What the reading leaves open comes from the prior on depth.
    """
    w = workspace(space)
    count = invert(space, model, sensor, z, R, w)
    J = w.spread[:, :count].copy()
    return w.point.copy(), J @ w.whitened[:count, :count].copy() @ J.T
