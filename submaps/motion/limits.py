"""Which controls a vehicle can follow: what has to be refused before it is applied."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from submaps.config import MotionConfig

# rad. A front wheel may stand across or backwards; a car's turning circle shrinks to nothing before.
STEER_LIMIT = {"bicycle": math.pi, "ackermann": 1.5}
# The encoder's wheel stands still, and tells nothing of the axle's middle, where this is 0.
LEAST_ENCODER_FACTOR = 0.05


def followable(config: MotionConfig, control: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether each of the controls (d, c) can be followed; a steer is the second channel (rad)."""
    if config.model not in STEER_LIMIT:
        return np.ones(control.shape[1], dtype=bool)
    steer = control[1]
    good: NDArray[np.bool_] = np.abs(steer) <= STEER_LIMIT[config.model]
    if config.encoder_offset and config.wheelbase:
        good &= 1.0 - np.tan(steer) * (config.encoder_offset / config.wheelbase) > LEAST_ENCODER_FACTOR
    return good


def expected_steer(config: MotionConfig) -> str:
    """What ``followable`` wants of a vehicle's steer, in words."""
    expected = f"a steer within {STEER_LIMIT[config.model]:.4g} rad of straight ahead"
    if config.encoder_offset:
        expected += f", 1 - tan(steer) encoder_offset / wheelbase above {LEAST_ENCODER_FACTOR}"
    return expected
