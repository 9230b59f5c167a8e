"""Messages about what sets a robot apart from its map's defaults."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numpy as np
from pydantic import Field, TypeAdapter

from service.wire.base import MAP_FRAME, Matrix, Name, Number, Wire, example
from service.wire.checks import check_covariances, check_square
from service.wire.maps import Config
from service.wire.models import AnyMotion, Observation, motion_to_core, observation_to_core, refusals
from service.wire.poses import rotation_of, unit_quaternion
from submaps.config import RobotConfig, Start, check_models
from submaps.geometry.space import Pose

_FRAME: dict[str, Any] = {"frame": "map", "x": 100.0, "y": -20.0}
_START: dict[str, Any] = {**_FRAME, "theta": 1.57, "covariance": [[0.25, 0.0, 0.0], [0.0, 0.25, 0.0], [0.0, 0.0, 0.01]]}
_SPATIAL_START: dict[str, Any] = {
    **_FRAME, "z": 1.5, "quaternion": [0.0, 0.0, 0.7071, 0.7071],
    "covariance": [[0.25 * (i == j) for j in range(6)] for i in range(6)],
}  # fmt: skip
_MOTION = {"model": "ackermann", "sigma": [0.1, 0.02], "wheelbase": 2.83, "encoder_offset": 0.76}
_OBSERVATION = {"model": "range_bearing", "sigma": [0.1, 0.02], "mount": [3.78, 0.5, 0.0]}
_SPATIAL_OBSERVATION = {
    "model": "cartesian3d",
    "sigma": [0.02, 0.02, 0.02],
    "mount": [0.1, 0.0, 0.3, 0.0, 0.0, 0.0, 1.0],
}


class StartPose(Wire):
    """Where a robot's first pose lies, as far as its operator knows, in a map in se2."""

    frame: str = Field(pattern=MAP_FRAME, description="`map`, or `submap/{k}` of a sub-map that exists")
    x: Number = Field(description="m")
    y: Number = Field(description="m")
    theta: Number = Field(description="rad, counter-clockwise")
    covariance: Matrix = Field(
        description="3x3, of the errors of x, y and theta along the frame's axes; symmetric and positive definite"
    )

    def to_core(self) -> Start:
        """Return the estimator's start; raises ``Problem`` (422) for a covariance that is none."""
        return _start(self.frame, (self.x, self.y, self.theta), self.covariance)


class SpatialStartPose(Wire):
    """Where a robot's first pose lies, as far as its operator knows, in a map in se3."""

    frame: str = Field(pattern=MAP_FRAME, description="`map`, or `submap/{k}` of a sub-map that exists")
    x: Number = Field(description="m")
    y: Number = Field(description="m")
    z: Number = Field(description="m")
    quaternion: list[Number] = Field(min_length=4, max_length=4, description="unit quaternion x, y, z, w")
    covariance: Matrix = Field(
        description="6x6, of the errors of x, y, z and of the rotation about the frame's axes, R = exp(e) R of the "
        "start; symmetric and positive definite"
    )

    def to_core(self) -> Start:
        """Return the estimator's start; raises ``Problem`` (422) where a value is no rotation or no covariance."""
        rotation = rotation_of(unit_quaternion("start.quaternion", self.quaternion))
        return _start(self.frame, (self.x, self.y, self.z, *rotation), self.covariance)


def _start(frame: str, pose: Pose, covariance: list[list[float]]) -> Start:
    where = "start.covariance"
    check_square(where, covariance, len(pose))
    (matrix,) = check_covariances(np.array([covariance], dtype=np.float64), lambda _: where)
    with refusals():
        return Start(frame, pose, tuple(map(tuple, matrix.tolist())))


class _Models(Wire):
    motion: AnyMotion | None = None
    observation: Observation | None = None


class RobotRequest(_Models):
    """What sets a robot apart in a map in se2; what is absent is the map's, and there is no start."""

    model_config = example(motion=_MOTION, observation=_OBSERVATION, start=_START)

    start: StartPose | None = None

    def completed(self, defaults: Config) -> RobotSettings:
        """Return what the robot has then, with the map's defaults."""
        return RobotSettings(**_completed(self, defaults), start=self.start)


class SpatialRobotRequest(_Models):
    """What sets a robot apart in a map in se3; what is absent is the map's, and there is no start."""

    model_config = example(observation=_SPATIAL_OBSERVATION, start=_SPATIAL_START)

    start: SpatialStartPose | None = None

    def completed(self, defaults: Config) -> SpatialRobotSettings:
        """Return what the robot has then, with the map's defaults."""
        return SpatialRobotSettings(**_completed(self, defaults), start=self.start)


def _completed(request: _Models, defaults: Config) -> dict[str, Any]:
    return {
        "motion": request.motion or defaults.motion,
        "observation": request.observation or defaults.observation,
    }


class RobotSettings(Wire):
    """What a robot has; the journal keeps it."""

    motion: AnyMotion
    observation: Observation
    start: StartPose | None = Field(description="null where nothing is known of its first pose")

    def to_core(self) -> RobotConfig:
        """Return the estimator's configuration of the robot; raises ``Problem`` (422) where it refuses a value."""
        return _to_core("se2", self)


class SpatialRobotSettings(Wire):
    """What a robot has in a map in se3; the journal keeps it."""

    motion: AnyMotion
    observation: Observation
    start: SpatialStartPose | None = Field(description="null where nothing is known of its first pose")

    def to_core(self) -> RobotConfig:
        """Return the estimator's configuration of the robot; raises ``Problem`` (422) where it refuses a value."""
        return _to_core("se3", self)


AnySettings: TypeAlias = RobotSettings | SpatialRobotSettings


def _to_core(space: str, settings: AnySettings) -> RobotConfig:
    start = None if settings.start is None else settings.start.to_core()
    motion, observation = motion_to_core(settings.motion), observation_to_core(settings.observation)
    with refusals():
        check_models(space, motion, observation)
    return RobotConfig(motion, observation, start)


class RobotSettingsAnswer(RobotSettings):
    """A robot that is set apart."""

    model_config = example(id="r2", motion=_MOTION, observation=_OBSERVATION, start=_START)

    id: Name


class SpatialRobotSettingsAnswer(SpatialRobotSettings):
    """A robot that is set apart in a map in se3."""

    model_config = example(
        id="r2", motion={"model": "none"}, observation=_SPATIAL_OBSERVATION, start=_SPATIAL_START
    )  # fmt: skip

    id: Name


AnyRequest: TypeAlias = RobotRequest | SpatialRobotRequest
# By the space of the map.
ROBOT_REQUESTS: dict[str, TypeAdapter[AnyRequest]] = {
    "se2": TypeAdapter(RobotRequest),
    "se3": TypeAdapter(SpatialRobotRequest),
}
ROBOTS: dict[str, TypeAdapter[AnySettings]] = {
    "se2": TypeAdapter(RobotSettings),
    "se3": TypeAdapter(SpatialRobotSettings),
}
_EXPECTED = {"se2": "x, y, theta and a 3x3 covariance", "se3": "x, y, z, quaternion and a 6x6 covariance"}


def start_hint(space: str) -> Callable[[Mapping[str, Any]], str | None]:
    """Return what may be added to a fault of a start: which fields a map of this space takes."""

    def hint(error: Mapping[str, Any]) -> str | None:
        inside = error["loc"][:1] == ("start",) and error["type"] in ("missing", "extra_forbidden")
        return f"a start in a map in {space} has {_EXPECTED[space]}" if inside else None

    return hint
