"""Messages about what sets a robot apart from its map's defaults."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import Field, TypeAdapter

from service.wire.base import MAP_FRAME, Matrix, Name, Number, Wire, example
from service.wire.checks import check_covariances, check_square
from service.wire.maps import (
    AnyMotion,
    Config,
    Observation,
    motion_to_core,
    observation_to_core,
    refusals,
)
from submaps.config import RobotConfig, Start

_START: dict[str, Any] = {
    "frame": "map", "x": 100.0, "y": -20.0, "theta": 1.57,
    "covariance": [[0.25, 0.0, 0.0], [0.0, 0.25, 0.0], [0.0, 0.0, 0.01]],
}  # fmt: skip
_MOTION = {"model": "ackermann", "sigma": [0.1, 0.02], "wheelbase": 2.83, "encoder_offset": 0.76}
_OBSERVATION = {"model": "range_bearing", "sigma": [0.1, 0.02], "mount": [3.78, 0.5, 0.0]}


class StartPose(Wire):
    """Where a robot's first pose lies, as far as its operator knows."""

    frame: str = Field(pattern=MAP_FRAME, description="`map`, or `submap/{k}` of a sub-map that exists")
    x: Number = Field(description="m")
    y: Number = Field(description="m")
    theta: Number = Field(description="rad, counter-clockwise")
    covariance: Matrix = Field(
        description="3x3, of the errors of x, y and theta along the frame's axes; symmetric and positive definite"
    )

    def to_core(self) -> Start:
        """Return the estimator's start; raises ``Problem`` (422) for a covariance that is none."""
        where = "start.covariance"
        check_square(where, self.covariance, 3)
        (matrix,) = check_covariances(np.array([self.covariance], dtype=np.float64), lambda _: where)
        a, b, c = matrix.tolist()
        with refusals():
            return Start(self.frame, (self.x, self.y, self.theta), (tuple(a), tuple(b), tuple(c)))


class RobotRequest(Wire):
    """What sets a robot apart; what is absent is the map's, and there is no start."""

    model_config = example(motion=_MOTION, observation=_OBSERVATION, start=_START)

    motion: AnyMotion | None = None
    observation: Observation | None = None
    start: StartPose | None = None

    def completed(self, defaults: Config) -> RobotSettings:
        """Return what the robot has then, with the map's defaults."""
        return RobotSettings(
            motion=self.motion or defaults.motion,
            observation=self.observation or defaults.observation,
            start=self.start,
        )


class RobotSettings(Wire):
    """What a robot has; the journal keeps it."""

    motion: AnyMotion
    observation: Observation
    start: StartPose | None = Field(description="null where nothing is known of its first pose")

    def to_core(self) -> RobotConfig:
        """Return the estimator's configuration of the robot; raises ``Problem`` (422) where it refuses a value."""
        start = None if self.start is None else self.start.to_core()
        return RobotConfig(motion_to_core(self.motion), observation_to_core(self.observation), start)


class RobotSettingsAnswer(RobotSettings):
    """A robot that is set apart."""

    model_config = example(id="r2", motion=_MOTION, observation=_OBSERVATION, start=_START)

    id: Name


ROBOT_REQUEST = TypeAdapter(RobotRequest)
ROBOT = TypeAdapter(RobotSettings)
