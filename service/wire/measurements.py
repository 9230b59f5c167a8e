"""Measurements as a client sends them: rows, which are friendly, and columns, which are fast."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

from pydantic import ConfigDict, Field

from service.wire.answers import Pose, SpatialPose
from service.wire.base import (
    FAIL_FAST,
    Indices,
    Landmark,
    LandmarkId,
    Matrices,
    Matrix,
    Name,
    Number,
    Seconds,
    Wire,
)

Sequence = Annotated[int, Field(ge=1, le=2**53, description="1 for a robot's first batch; rises by one", examples=[1])]
Steps = "at least one step; t rises, or equals the step before where there is no control"


class Odometry(Wire):
    """The increment of the pose since the step before, in the body frame then."""

    dx: Number = Field(description="m")
    dy: Number = Field(description="m")
    dtheta: Number = Field(description="rad")
    covariance: Matrix | None = Field(None, description="3x3, of this reading, in place of the robot's sigma")


class Velocity(Wire):
    """What the vehicle did since the step before."""

    v: Number = Field(description="m/s")
    omega: Number = Field(description="rad/s")


class Wheel(Wire):
    """Speed and direction of a wheel since the step before."""

    speed: Number = Field(description="m/s")
    steer: Number = Field(description="rad, counter-clockwise from straight ahead")


class Bicycle(Wheel):
    """What the front wheel did since the step before; its steer lies within pi."""


class Ackermann(Wheel):
    """What a car's encoder and steering did since the step before.

    The steer lies within 1.5 rad, and 1 - tan(steer) encoder_offset / wheelbase above 0.05.
    """


class CartesianPoint(Wire):
    """A point in the sensor's frame."""

    x: Number = Field(description="m, forward")
    y: Number = Field(description="m, to the left")
    covariance: Matrix | None = Field(None, description="2x2, in place of the robot's sigma")


class RangeBearingPoint(Wire):
    """A point at a distance and a direction from the sensor."""

    range: Annotated[Number, Field(gt=0)] = Field(description="m")
    bearing: Number = Field(description="rad, counter-clockwise from forward")
    covariance: Matrix | None = Field(None, description="2x2, in place of the robot's sigma")


class CartesianObservation(CartesianPoint):
    """A landmark at a point in the sensor's frame."""

    landmark: Landmark = None


class RangeBearingObservation(RangeBearingPoint):
    """A landmark at a distance and a direction from the sensor."""

    landmark: Landmark = None


class CartesianEncounter(CartesianPoint):
    """Another robot, its origin at a point in the sensor's frame."""

    robot: Name = Field(description="its name on this map", examples=["r2"])


class RangeBearingEncounter(RangeBearingPoint):
    """Another robot, its origin at a distance and a direction from the sensor."""

    robot: Name = Field(description="its name on this map", examples=["r2"])


MET = "other robots of this map that were seen; the robots' clocks have to agree"


class Step(Wire):
    """One moment: the control that led to it, if any, and what was seen at it."""

    # The fields that hold a control, one for each motion model.
    CONTROLS: ClassVar[tuple[str, ...]] = ("odometry", "velocity", "bicycle", "ackermann")

    t: Seconds
    odometry: Odometry | None = None
    velocity: Velocity | None = None
    bicycle: Bicycle | None = None
    ackermann: Ackermann | None = None


class CartesianStep(Step):
    """A step of a robot whose observations are cartesian."""

    observations: Annotated[list[CartesianObservation], FAIL_FAST] = Field(default_factory=list)
    encounters: Annotated[list[CartesianEncounter], FAIL_FAST] = Field(default_factory=list, description=MET)


class RangeBearingStep(Step):
    """A step of a robot whose observations are range and bearing."""

    observations: Annotated[list[RangeBearingObservation], FAIL_FAST] = Field(default_factory=list)
    encounters: Annotated[list[RangeBearingEncounter], FAIL_FAST] = Field(default_factory=list, description=MET)


ROWS_EXAMPLE: dict[str, Any] = {
    "sequence": 1,
    "steps": [
        {
            "t": 0.1,
            "odometry": {"dx": 1.0, "dy": 0.0, "dtheta": 0.02},
            "observations": [{"landmark": "7", "x": 11.5, "y": -3.2}],
        }
    ],
}
RANGE_BEARING_EXAMPLE: dict[str, Any] = {
    "sequence": 1,
    "steps": [
        {
            "t": 0.1,
            "velocity": {"v": 1.0, "omega": 0.02},
            "observations": [{"landmark": "7", "range": 11.9, "bearing": -0.27}],
            "encounters": [{"robot": "r2", "range": 2.0, "bearing": 0.3}],
        }
    ],
}
COLUMNS_EXAMPLE: dict[str, Any] = {
    "sequence": 1,
    "t": [0.1],
    "control": [[1.0], [0.0], [0.02]],
    "observation": {"step": [0], "landmark": ["7"], "z": [[11.5], [-3.2]]},
}


class CartesianRows(Wire):
    """A batch as rows, for a robot whose observations are cartesian."""

    model_config = ConfigDict(json_schema_extra={"examples": [ROWS_EXAMPLE]})

    sequence: Sequence
    steps: Annotated[list[CartesianStep], FAIL_FAST] = Field(min_length=1, description=Steps)


class RangeBearingRows(Wire):
    """A batch as rows, for a robot whose observations are range and bearing."""

    model_config = ConfigDict(json_schema_extra={"examples": [RANGE_BEARING_EXAMPLE]})

    sequence: Sequence
    steps: Annotated[list[RangeBearingStep], FAIL_FAST] = Field(min_length=1, description=Steps)


class ObservationColumns(Wire):
    """Observations in the order of their steps."""

    step: Indices = Field(description="the step of each observation, counted from 0; does not fall")
    landmark: Annotated[list[LandmarkId], FAIL_FAST] | None = Field(
        None, description="ids; absent in a map that finds out which landmark an observation is of"
    )
    z: Matrix = Field(description="one list a channel of the observation model, in the order of its rows' fields")
    covariance: Matrices | None = Field(
        None, description="for each observation, channels x channels, in place of the robot's sigma"
    )


class EncounterColumns(Wire):
    """Other robots of this map that were seen, in the order of the steps; the robots' clocks have to agree.

    Only in a map in se2.
    """

    step: Indices = Field(description="the step of each encounter, counted from 0; does not fall")
    robot: Annotated[list[Name], FAIL_FAST] = Field(description="the other robots' names")
    z: Matrix = Field(description="one list a channel of the observation model, of the other robot's origin")
    covariance: Matrices | None = Field(
        None, description="for each encounter, channels x channels, in place of the robot's sigma"
    )


class Columns(Wire):
    """A batch as columns: the same content as rows, and several times as fast."""

    model_config = ConfigDict(json_schema_extra={"examples": [COLUMNS_EXAMPLE]})

    sequence: Sequence
    t: Annotated[list[Seconds], FAIL_FAST] = Field(min_length=1, description=Steps)
    control: Matrix | None = Field(
        None,
        description="one list a channel of the motion model: dx, dy, dtheta; v, omega; speed, steer; or dx, dy, dz, "
        "rx, ry, rz",
    )
    control_step: Indices | None = Field(None, description="the steps that have a control, if not all do")
    control_covariance: Matrices | None = Field(
        None, description="3x3 for each odometry, 6x6 for each odometry3d, in place of the robot's sigma"
    )
    observation: ObservationColumns | None = None
    encounter: EncounterColumns | None = None


class Rejected(Wire):
    """An observation of a landmark, or an encounter with another robot, that was set aside."""

    step: int
    observation: int = Field(description="counted from 0 within the observations, or the encounters, of its step")
    landmark: str | None = Field(
        None, description="absent for an encounter; of an ambiguous observation the nearest landmark"
    )
    robot: str | None = Field(None, description="the other robot of an encounter; absent for a landmark")
    reason: str = Field(
        description="`gate`: beyond the map's gate; `unlikely`: used, but flagged; `singular`: no innovation could "
        "be formed; `late`: the robot met had gone too far on; `lost`: without motion, too little is seen for a pose; "
        "`ambiguous`: neither near enough to a landmark to be of it nor far enough from all to be another, or second "
        "to one that is nearer"
    )
    nis: float | None = Field(description="normalised innovation squared, where one could be formed")


class RobotPose(Pose):
    """Where the robot is after a batch, in its sub-map."""

    frame: str = Field(examples=["submap/3"])
    t: float


class SpatialRobotPose(SpatialPose):
    """Where the robot is after a batch, in its sub-map, in a map in se3."""

    frame: str = Field(examples=["submap/3"])
    t: float


class Acknowledgement(Wire):
    """What became of a batch: it is on disk, applied, and every query sees it."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "sequence": 1,
                    "steps": 1,
                    "observations": 1,
                    "rejected": [{"step": 0, "observation": 0, "landmark": "7", "reason": "gate", "nis": 31.7}],
                    "flagged": [],
                    "submap": 3,
                    "map_version": 12,
                    "duplicate": False,
                    "pose": {"frame": "submap/3", "t": 0.1, "x": 0.9, "y": 0.1, "theta": 0.02},
                }
            ]
        }
    )

    sequence: int
    steps: int
    observations: int = Field(description="encounters included")
    rejected: list[Rejected]
    flagged: list[Rejected] = Field(description="used, but less likely than 1 in 10 000")
    submap: int
    map_version: int
    duplicate: bool = Field(description="this batch had been acknowledged before")
    pose: RobotPose | SpatialRobotPose
    landmarks: list[str | None] | None = Field(
        None,
        description="in a map that finds landmarks itself: that of each observation, in order, null if ambiguous; "
        "absent elsewhere",
    )
