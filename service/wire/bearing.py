"""Measurements of robots that see directions alone, as rows; a prior on depth makes landmarks of them."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import ConfigDict, Field

from service.wire.base import FAIL_FAST, Landmark, Matrix, Name, Turn, Wire
from service.wire.measurements import MET, Sequence, Step, Steps


class BearingPoint(Wire):
    """A point in a direction from the sensor."""

    bearing: Turn = Field(description="rad, counter-clockwise from forward")
    covariance: Matrix | None = Field(None, description="1x1, in place of the robot's sigma")


class BearingObservation(BearingPoint):
    """A landmark in a direction from the sensor."""

    landmark: Landmark = None


class BearingEncounter(BearingPoint):
    """Another robot, its origin in a direction from the sensor."""

    robot: Name = Field(description="its name on this map", examples=["r2"])


class BearingStep(Step):
    """A step of a robot whose observations are bearings."""

    observations: Annotated[list[BearingObservation], FAIL_FAST] = Field(default_factory=list)
    encounters: Annotated[list[BearingEncounter], FAIL_FAST] = Field(default_factory=list, description=MET)


BEARING_EXAMPLE: dict[str, Any] = {
    "sequence": 1,
    "steps": [
        {
            "t": 0.1,
            "odometry": {"dx": 1.0, "dy": 0.0, "dtheta": 0.02},
            "observations": [{"landmark": "7", "bearing": -0.27}],
        }
    ],
}


class BearingRows(Wire):
    """A batch as rows, for a robot whose observations are bearings."""

    model_config = ConfigDict(json_schema_extra={"examples": [BEARING_EXAMPLE]})

    sequence: Sequence
    steps: Annotated[list[BearingStep], FAIL_FAST] = Field(min_length=1, description=Steps)
