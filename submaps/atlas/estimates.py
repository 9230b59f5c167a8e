"""What a view answers with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from submaps.geometry.se2 import Pose

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PoseEstimate:
    """A pose (x m, y m, theta rad) in a frame, with the (3, 3) covariance of its additive errors."""

    frame: str
    t: float
    x: float
    y: float
    theta: float
    covariance: Floats
    kind: str
    submap: int
    map_T_odom: Pose | None = None


@dataclass(frozen=True)
class LandmarkEstimate:
    """A landmark's position (m) in a frame, with its (2, 2) covariance and the sub-maps that hold it."""

    id: str
    x: float
    y: float
    covariance: Floats
    submaps: tuple[int, ...]


@dataclass(frozen=True)
class SubmapState:
    """What the atlas says of one sub-map; ``pose`` is its frame in ``map``, ``None`` if not connected."""

    id: int
    robot: str
    active: bool
    pose: Pose | None
    covariance: Floats | None
    landmarks: int
    steps: int
    observations: int
    nis: float | None
    began: float
    ended: float | None
