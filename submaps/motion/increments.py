"""Columns of controls to body-frame increments and their covariances; what the kernel takes in."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.config import MotionConfig
from submaps.filtering.predicting import accumulate, accumulate_in_space
from submaps.geometry.space import SPACES, Key
from submaps.measurements import Batch, Ints
from submaps.motion import ackermann, bicycle, odometry, velocity

Floats = NDArray[np.float64]

_odometry, _odometry_in_space = odometry.increment, odometry.increment_in_space
_velocity = velocity.increment
_bicycle = bicycle.increment
_ackermann = ackermann.increment
MODELS = {"odometry": 0, "velocity": 1, "bicycle": 2, "ackermann": 3, "odometry3d": 4, "none": 5}
# s. Over a shorter interval a density's noise no longer grows: its reciprocal has to stay finite.
SHORTEST = 1e-9


@jit(
    "void(int64, float64, float64, float64[:, ::1], float64[:, :, ::1], float64[::1], float64[::1], float64[:, ::1],"
    " float64[:, :, ::1])"
)
def _increments(
    model: int, wheelbase: float, offset: float, control: Floats, covariance: Floats, slip: Floats, dt: Floats,
    out: Floats, out_covariance: Floats,
) -> None:  # fmt: skip
    each, slips = covariance.shape[0] > 1, slip.shape[0] > 1
    for k in range(control.shape[1]):
        noise, lateral = covariance[k if each else 0], slip[k if slips else 0]
        if model == 0:
            _odometry(control[:, k], noise, out[k], out_covariance[k])
        elif model == 1:
            _velocity(control[:, k], noise, lateral, dt[k], out[k], out_covariance[k])
        elif model == 4:
            _odometry_in_space(control[:, k], noise, out[k], out_covariance[k])
        elif model == 2:
            _bicycle(control[:, k], noise, wheelbase, dt[k], out[k], out_covariance[k])
        else:
            _ackermann(control[:, k], noise, lateral, wheelbase, offset, dt[k], out[k], out_covariance[k])


def increments(config: MotionConfig, batch: Batch, previous_t: float | None) -> tuple[Floats, Floats]:
    """Increments (c, pose) and covariances (c, pose, pose) of a batch's controls, pose 3 or 6 numbers.

    The order is (x, y, theta), in space (x, y, z, rotation vector), the errors those of ``geometry.space``.
    Each control covers the time from the step before it (``previous_t`` for the first; ``None``
    for a robot's very first step, whose control has no duration).
    """
    before = np.empty_like(batch.t)
    before[1:] = batch.t[:-1]
    before[0] = batch.t[0] if previous_t is None else previous_t
    dt = (batch.t - before)[batch.control_step]
    covariance, slip = _noise(config, batch.control_covariance, dt)
    wheelbase, offset = config.wheelbase or 0.0, config.encoder_offset
    count, pose = batch.control.shape[1], SPACES[config.space].pose
    out = np.empty((count, pose))
    out_covariance = np.empty((count, pose, pose))
    _increments(
        MODELS[config.model], wheelbase, offset, batch.control, covariance, slip, dt, out, out_covariance
    )  # fmt: skip
    return out, out_covariance


def _noise(config: MotionConfig, own: Floats | None, dt: Floats) -> tuple[Floats, Floats]:
    """Covariances of readings (1 or c, d, d) and standard deviations of slip (1 or c,) over ``dt`` (c,) s.

    ``own`` (c, d, d) are those that came with the readings, NaN where the model's stands.
    """
    covariance, slip = _of_model(config)
    if config.noise == "density":
        # A velocity of variance sigma²/dt moves by one of sigma² dt, as an increment does by itself.
        share = dt if config.model in ("odometry", "odometry3d") else 1.0 / np.maximum(dt, SHORTEST)
        covariance, slip = covariance * share[:, np.newaxis, np.newaxis], slip * np.sqrt(share)
    if own is not None and own.shape[0]:
        covariance = np.where(np.isnan(own[:, :1, :1]), covariance, own)
    return covariance, slip


@lru_cache(maxsize=256)
def _of_model(config: MotionConfig) -> tuple[Floats, Floats]:
    """Covariance (1, d, d) and slip (1,) of a model's readings; nobody changes them."""
    channels = len(config.channels)
    return np.diag(np.square(config.sigma[:channels]))[np.newaxis], np.array(config.sigma[channels:] or (0.0,))


_ARRAYS = "float64[::1], float64[:, ::1], float64[:, ::1], float64[:, :, ::1], int64[::1], float64[:, ::1])"


@jit("void(UniTuple(int64, 2), " + _ARRAYS, "void(UniTuple(int64, 3), " + _ARRAYS)
def dead_reckon(
    space: Key, pose: Floats, covariance: Floats, steps: Floats, noises: Floats, control_step: Ints, track: Floats
) -> None:
    """Compose increments (c, pose) onto a pose and its covariance (pose, pose), in place.

    ``track`` (n, pose) receives the pose after each step; increment k belongs to ``control_step[k]``.
    """
    k = 0
    for step in range(track.shape[0]):
        if k < control_step.shape[0] and control_step[k] == step:
            if len(space) == 2:
                accumulate(pose, covariance, steps[k], noises[k])
            else:
                accumulate_in_space(pose, covariance, steps[k], noises[k])
            k += 1
        for i in range(pose.shape[0]):
            track[step, i] = pose[i]
