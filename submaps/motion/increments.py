"""Columns of controls to body-frame increments and their covariances; what the kernel takes in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.config import MotionConfig
from submaps.filtering.kernel import accumulate
from submaps.measurements import Batch, Ints
from submaps.motion import odometry, velocity

Floats = NDArray[np.float64]

_odometry = odometry.increment
_velocity = velocity.increment
MODELS = {"odometry": 0, "velocity": 1}


@jit("void(int64, float64[:, ::1], float64[:, :, ::1], float64, float64[::1], float64[:, ::1], float64[:, :, ::1])")
def _increments(
    model: int, control: Floats, covariance: Floats, slip: float, dt: Floats, out: Floats, out_covariance: Floats
) -> None:
    own = covariance.shape[0] > 1
    for k in range(control.shape[1]):
        noise = covariance[k if own else 0]
        if model == 0:
            _odometry(control[:, k], noise, out[k], out_covariance[k])
        else:
            _velocity(control[:, k], noise, slip, dt[k], out[k], out_covariance[k])


def increments(config: MotionConfig, batch: Batch, previous_t: float | None) -> tuple[Floats, Floats]:
    """Increments (c, 3) and covariances (c, 3, 3), order (x, y, theta), of a batch's controls.

    Each control covers the time from the step before it (``previous_t`` for the first; ``None``
    for a robot's very first step, whose control has no duration).
    """
    channels = len(config.channels)
    before = np.empty_like(batch.t)
    before[1:] = batch.t[:-1]
    before[0] = batch.t[0] if previous_t is None else previous_t
    dt = (batch.t - before)[batch.control_step]
    covariance = batch.control_covariance
    if covariance is None or covariance.shape[0] == 0:
        covariance = np.diag(np.square(config.sigma[:channels]))[np.newaxis]
    elif covariance.shape[0] == 1:  # one row would read as the model's default for every control
        covariance = np.repeat(covariance, 2, axis=0)
    slip = config.sigma[2] if config.model == "velocity" and len(config.sigma) == 3 else 0.0
    count = batch.control.shape[1]
    out = np.empty((count, 3))
    out_covariance = np.empty((count, 3, 3))
    _increments(MODELS[config.model], batch.control, covariance, slip, dt, out, out_covariance)
    return out, out_covariance


@jit("void(float64[::1], float64[:, ::1], float64[:, ::1], float64[:, :, ::1], int64[::1], float64[:, ::1])")
def dead_reckon(
    pose: Floats, covariance: Floats, steps: Floats, noises: Floats, control_step: Ints, track: Floats
) -> None:
    """Compose increments (c, 3) onto a pose (3,) and its covariance (3, 3), in place.

    ``track`` (n, 3) receives the pose after each step; increment k belongs to ``control_step[k]``.
    """
    k = 0
    for step in range(track.shape[0]):
        if k < control_step.shape[0] and control_step[k] == step:
            accumulate(pose, covariance, steps[k], noises[k])
            k += 1
        track[step, 0], track[step, 1], track[step, 2] = pose[0], pose[1], pose[2]
