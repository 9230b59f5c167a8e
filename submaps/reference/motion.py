"""Motion models: a control becomes a body-frame increment with its covariance, whatever the pose.

The models are those of the main path, one file each in ``submaps.motion``; their equations stand
there. The increment (v, w) moves a pose by p + R v, R exp(w) (``retraction.after``). In space its rotation is a
rotation vector, and its error that of ``geometry.space``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from submaps.config import MotionConfig
from submaps.measurements import Batch
from submaps.motion.increments import increments

Floats = NDArray[np.float64]


def increment(
    config: MotionConfig, control: Sequence[float], dt: float, covariance: Floats | None = None
) -> tuple[Floats, Floats]:
    """Increment (pose,) and covariance (pose, pose) of one control over ``dt`` (s), with its own covariance or not."""
    reading = np.array(control, dtype=np.float64)[:, np.newaxis]
    batch = Batch(
        t=np.array([dt]), control_step=np.zeros(1, dtype=np.int64), control=reading,
        control_covariance=None if covariance is None else covariance[np.newaxis],
        observation_step=np.zeros(0, dtype=np.int64), landmark=(), z=np.empty((2, 0)), observation_covariance=None,
    )  # fmt: skip
    moved, noise = increments(config, batch, 0.0)
    return moved[0], noise[0]
