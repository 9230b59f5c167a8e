"""The table of observation models that the compiled kernel chooses from.

A model knows the sensor's frame alone: h(s), dh/ds and the point that a reading shows; a Cartesian one shows s
itself. Here the sensor's mount is added: s = R_m^T (y - m), with y the landmark in the body frame. A ``sensor``
is the mount's position (dim) and rotation matrix (dim * dim, row by row), then fu, fv, cu, cv, baseline, and
mean and sigma of a depth.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.config import ObservationConfig
from submaps.filtering.workspace import (
    CARRIED,
    INNER,
    INNOVATION,
    POINT,
    PREDICTED,
    READING_NOISE,
    SEEN,
    SLOPE,
    SPREAD,
    workspace,
)
from submaps.geometry import so3
from submaps.geometry.space import Key, Space
from submaps.geometry.trig import wrap
from submaps.observation import bearing, pinhole, range_bearing, stereo

Floats = NDArray[np.float64]

_range_bearing_predict, _range_bearing_invert = range_bearing.predict, range_bearing.invert
_bearing_predict = bearing.predict
_stereo_predict, _stereo_invert = stereo.predict, stereo.invert
_pinhole_predict, _pinhole_invert = pinhole.predict, pinhole.invert
CARTESIAN, RANGE_BEARING, BEARING, STEREO, PINHOLE = 0, 1, 2, 3, 4
MODELS = {
    "cartesian": CARTESIAN, "cartesian3d": CARTESIAN, "range_bearing": RANGE_BEARING, "bearing": BEARING,
    "stereo": STEREO, "pinhole": PINHOLE,
}  # fmt: skip
_DEPTH, _PARAMETERS = 5, 7  # place of the depth's prior among the parameters, and how many there are


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


@jit(inline=True)
def channels(space: Key, model: int) -> int:
    """How many numbers a reading has."""
    if model == CARTESIAN:
        return len(space)
    if model == BEARING:
        return 1
    return 4 if model == STEREO else 2


@jit(inline=True)
def predict(space: Key, model: int, sensor: Floats, at: int, w: Floats) -> None:
    """h(y) and dh/dy of the body-frame point at ``POINT`` (m), to ``PREDICTED`` and ``SLOPE``.

    The sensor begins at ``sensor[at]``.
    """
    dim = len(space)
    turn = at + dim
    for i in range(dim):
        total = 0.0
        for j in range(dim):
            total += sensor[turn + j * dim + i] * (w[POINT + j] - sensor[at + j])
        w[SEEN + i] = total
    _in_sensor(space, model, sensor, turn + dim * dim, w)
    for a in range(channels(space, model)):
        for j in range(dim):
            total = 0.0
            for i in range(dim):
                total += w[INNER + dim * a + i] * sensor[turn + j * dim + i]
            w[SLOPE + dim * a + j] = total


@jit(inline=True)
def _in_sensor(space: Key, model: int, sensor: Floats, optics: int, w: Floats) -> None:
    """h(s) and dh/ds of the point at ``SEEN``, to ``PREDICTED`` and ``INNER``."""
    dim = len(space)
    x, y = w[SEEN], w[SEEN + 1]
    if model == CARTESIAN:
        for i in range(dim):
            w[PREDICTED + i] = w[SEEN + i]
            for j in range(dim):
                w[INNER + dim * i + j] = 1.0 if i == j else 0.0
    elif len(space) == 2:
        if model == RANGE_BEARING:
            w[PREDICTED], w[PREDICTED + 1], w[INNER], w[INNER + 1], w[INNER + 2], w[INNER + 3] = _range_bearing_predict(
                x, y
            )
        else:
            w[PREDICTED], w[INNER], w[INNER + 1] = _bearing_predict(x, y)
    else:
        z, fu, fv, cu, cv = w[SEEN + 2], sensor[optics], sensor[optics + 1], sensor[optics + 2], sensor[optics + 3]
        if model == STEREO:
            u, v, right, ux, vy, uz, vz, rz = _stereo_predict(x, y, z, fu, fv, cu, cv, sensor[optics + 4])
            w[PREDICTED], w[PREDICTED + 1], w[PREDICTED + 2], w[PREDICTED + 3] = u, v, right, v
            w[INNER], w[INNER + 1], w[INNER + 2] = ux, 0.0, uz
            w[INNER + 3], w[INNER + 4], w[INNER + 5] = 0.0, vy, vz
            w[INNER + 6], w[INNER + 7], w[INNER + 8] = ux, 0.0, rz
            w[INNER + 9], w[INNER + 10], w[INNER + 11] = 0.0, vy, vz
        else:
            u, v, ux, uy, uz, vx, vy, vz = _pinhole_predict(x, y, z, fu, fv, cu, cv)
            w[PREDICTED], w[PREDICTED + 1] = u, v
            w[INNER], w[INNER + 1], w[INNER + 2] = ux, uy, uz
            w[INNER + 3], w[INNER + 4], w[INNER + 5] = vx, vy, vz


@jit()
def invert(space: Key, model: int, sensor: Floats, at: int, z: Floats, zat: int, R: Floats, w: Floats) -> int:
    """The body-frame point (m) that the reading at ``z[zat]`` shows, to ``POINT``; how many numbers it follows from.

    ``SPREAD`` is its slope by those numbers, ``READING_NOISE`` their covariance: the reading's, and with it
    the prior of what a single reading leaves open.
    """
    dim, count = len(space), channels(space, model)
    for a in range(count):
        for b in range(count):
            w[READING_NOISE + 4 * a + b] = R[a, b]
    if model == CARTESIAN:
        for i in range(dim):
            w[SEEN + i] = z[zat + i]
            for j in range(dim):
                w[CARRIED + 4 * i + j] = 1.0 if i == j else 0.0
    elif len(space) == 2:
        count = _invert_in_plane(model, sensor, at + dim + dim * dim, z, zat, w)
    else:
        count = _invert_in_space(model, sensor, at + dim + dim * dim, z, zat, w)
    for i in range(dim):
        total = sensor[at + i]
        for j in range(dim):
            total += sensor[at + dim + i * dim + j] * w[SEEN + j]
        w[POINT + i] = total
        for b in range(count):
            total = 0.0
            for k in range(dim):
                total += sensor[at + dim + i * dim + k] * w[CARRIED + 4 * k + b]
            w[SPREAD + 4 * i + b] = total
    return count


@jit()
def _invert_in_plane(model: int, sensor: Floats, optics: int, z: Floats, zat: int, w: Floats) -> int:
    if model == BEARING:  # a range, known by its prior, and a bearing
        r, b = sensor[optics + _DEPTH], z[zat]
        w[READING_NOISE + 5] = w[READING_NOISE]
        w[READING_NOISE] = sensor[optics + _DEPTH + 1] * sensor[optics + _DEPTH + 1]
        w[READING_NOISE + 1] = w[READING_NOISE + 4] = 0.0
    else:
        r, b = z[zat], z[zat + 1]
    w[SEEN], w[SEEN + 1], w[CARRIED], w[CARRIED + 1], w[CARRIED + 4], w[CARRIED + 5] = _range_bearing_invert(r, b)
    return 2


@jit()
def _invert_in_space(model: int, sensor: Floats, optics: int, z: Floats, zat: int, w: Floats) -> int:
    fu, fv, cu, cv = sensor[optics], sensor[optics + 1], sensor[optics + 2], sensor[optics + 3]
    J = CARRIED
    for i in range(12):
        w[J + i] = 0.0
    if model == STEREO:
        left, right, row = z[zat], z[zat + 2], 0.5 * (z[zat + 1] + z[zat + 3])
        b = sensor[optics + 4]
        w[SEEN], w[SEEN + 1], w[SEEN + 2], xu, yu, zu, yv = _stereo_invert(left, row, right, fu, fv, cu, cv, b)
        w[J], w[J + 2] = xu + w[SEEN + 2] / fu, -xu
        w[J + 4], w[J + 5], w[J + 6], w[J + 7] = yu, 0.5 * yv, -yu, 0.5 * yv
        w[J + 8], w[J + 10] = zu, -zu
        return 4
    depth, sigma = sensor[optics + _DEPTH], sensor[optics + _DEPTH + 1]
    x, y = _pinhole_invert(z[zat], z[zat + 1], fu, fv, cu, cv)
    w[SEEN], w[SEEN + 1], w[SEEN + 2] = depth * x, depth * y, depth
    w[J], w[J + 2], w[J + 5], w[J + 6], w[J + 10] = depth / fu, x, depth / fv, y, 1.0
    for a in range(2):
        w[READING_NOISE + 4 * a + 2] = w[READING_NOISE + 8 + a] = 0.0
    w[READING_NOISE + 10] = sigma * sigma
    return 3


@jit(inline=True)
def innovate(space: Key, model: int, z: Floats, zat: int, w: Floats) -> None:
    """z - h to ``INNOVATION``, with a bearing's difference wrapped to [-pi, pi)."""
    for a in range(channels(space, model)):
        w[INNOVATION + a] = z[zat + a] - w[PREDICTED + a]
    if model == RANGE_BEARING:
        w[INNOVATION + 1] = wrap(w[INNOVATION + 1])
    elif model == BEARING:
        w[INNOVATION] = wrap(w[INNOVATION])


@jit(
    "Tuple((float64[::1], float64[:, ::1]))(UniTuple(int64, 2), int64, float64[::1], float64[::1])",
    "Tuple((float64[::1], float64[:, ::1]))(UniTuple(int64, 3), int64, float64[::1], float64[::1])",
)
def reading(space: Key, model: int, sensor: Floats, y: Floats) -> tuple[Floats, Floats]:
    """h(y) (channels,) and dh/dy (channels, dim) of a body-frame point y (dim,), m."""
    w, dim, count = workspace(), len(space), channels(space, model)
    w[POINT : POINT + dim] = y
    predict(space, model, sensor, 0, w)
    slope = w[SLOPE : SLOPE + count * dim].copy()
    return w[PREDICTED : PREDICTED + count].copy(), slope.reshape(count, dim)


@jit(
    "Tuple((float64[::1], float64[:, ::1]))(UniTuple(int64, 2), int64, float64[::1], float64[::1], float64[:, ::1])",
    "Tuple((float64[::1], float64[:, ::1]))(UniTuple(int64, 3), int64, float64[::1], float64[::1], float64[:, ::1])",
)
def shown(space: Key, model: int, sensor: Floats, z: Floats, R: Floats) -> tuple[Floats, Floats]:
    """The body-frame point (dim,), m, that a reading shows, and its covariance (dim, dim): a measurement inverted.

    What the reading leaves open comes from the prior on depth.
    """
    w, dim = workspace(), len(space)
    count = invert(space, model, sensor, 0, z, 0, R, w)
    J = w[SPREAD : SPREAD + 4 * dim].copy().reshape(dim, 4)
    noise = w[READING_NOISE : READING_NOISE + 16].copy().reshape(4, 4)
    out = np.zeros((dim, dim))
    for i in range(dim):
        for j in range(dim):
            for a in range(count):
                for b in range(count):
                    out[i, j] += J[i, a] * noise[a, b] * J[j, b]
    return w[POINT : POINT + dim].copy(), out
