"""What a view answers with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from submaps.geometry.space import Pose

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PoseEstimate:
    """A pose in a frame, with the (pose, pose) covariance of its additive errors (see ``geometry.space``).

    ``pose`` is (x m, y m, theta rad), in space (x m, y m, z m, rotation vector rad).
    """

    frame: str
    t: float
    pose: Pose
    covariance: Floats
    kind: str
    submap: int
    map_T_odom: Pose | None = None

    @property
    def x(self) -> float:
        """m."""
        return self.pose[0]

    @property
    def y(self) -> float:
        """m."""
        return self.pose[1]

    @property
    def theta(self) -> float:
        """The heading (rad), which a pose in the plane has."""
        _, _, theta = self.pose
        return theta


@dataclass(frozen=True)
class LandmarkEstimate:
    """A landmark's ``position`` (dim,) in m in a frame, its (dim, dim) covariance, the sub-maps that hold it."""

    id: str
    position: Floats
    covariance: Floats
    submaps: tuple[int, ...]

    @property
    def x(self) -> float:
        """m."""
        return float(self.position[0])

    @property
    def y(self) -> float:
        """m."""
        return float(self.position[1])


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
