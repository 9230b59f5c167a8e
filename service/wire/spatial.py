"""Measurements of maps in se3 as a client sends them, as rows."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

from pydantic import ConfigDict, Field

from service.wire.base import FAIL_FAST, Landmark, Matrix, Number, Seconds, Turn, Wire
from service.wire.measurements import Sequence, Steps


class Odometry3d(Wire):
    """The increment of the pose since the step before, in the body frame then: p += R d, R <- R exp(r)."""

    dx: Number = Field(description="m")
    dy: Number = Field(description="m")
    dz: Number = Field(description="m")
    rx: Turn = Field(description="rad, of the rotation vector")
    ry: Turn = Field(description="rad")
    rz: Turn = Field(description="rad")
    covariance: Matrix | None = Field(
        None, description="6x6, of this reading (dx, dy, dz, rx, ry, rz), in place of the robot's sigma"
    )


class Cartesian3dPoint(Wire):
    """A point in the sensor's frame."""

    x: Number = Field(description="m")
    y: Number = Field(description="m")
    z: Number = Field(description="m")
    covariance: Matrix | None = Field(None, description="3x3, in place of the robot's sigma")


class StereoPoint(Wire):
    """A point in the images of a pair of cameras.

    One that is not ahead (u_left - u_right not above 0) cannot begin a landmark: it comes back as `singular`.
    """

    u_left: Number = Field(description="px, to the right")
    v_left: Number = Field(description="px, down")
    u_right: Number = Field(description="px, to the right")
    v_right: Number = Field(description="px, down")
    covariance: Matrix | None = Field(None, description="4x4, in place of the robot's sigma")


class PinholePoint(Wire):
    """A point in a camera's image."""

    u: Number = Field(description="px, to the right")
    v: Number = Field(description="px, down")
    covariance: Matrix | None = Field(None, description="2x2, in place of the robot's sigma")


class Cartesian3dObservation(Cartesian3dPoint):
    """A landmark at a point in the sensor's frame."""

    landmark: Landmark = None


class StereoObservation(StereoPoint):
    """A landmark in the images of a pair of cameras."""

    landmark: Landmark = None


class PinholeObservation(PinholePoint):
    """A landmark in a camera's image."""

    landmark: Landmark = None


class SpatialStep(Wire):
    """One moment in space: the odometry that led to it, if any, and what was seen at it."""

    CONTROLS: ClassVar[tuple[str, ...]] = ("odometry",)

    t: Seconds
    odometry: Odometry3d | None = Field(None, description="only where the robot's motion model is `odometry3d`")


class Cartesian3dStep(SpatialStep):
    """A step of a robot whose observations are points."""

    observations: Annotated[list[Cartesian3dObservation], FAIL_FAST] = Field(default_factory=list)


class StereoStep(SpatialStep):
    """A step of a robot with a pair of cameras."""

    observations: Annotated[list[StereoObservation], FAIL_FAST] = Field(default_factory=list)


class PinholeStep(SpatialStep):
    """A step of a robot with one camera."""

    observations: Annotated[list[PinholeObservation], FAIL_FAST] = Field(default_factory=list)


def _example(seen: dict[str, Any]) -> dict[str, Any]:
    odometry = {"dx": 1.0, "dy": 0.0, "dz": 0.1, "rx": 0.0, "ry": 0.0, "rz": 0.02}
    return {"sequence": 1, "steps": [{"t": 0.1, "odometry": odometry, "observations": [{"landmark": "7", **seen}]}]}


CARTESIAN3D_EXAMPLE = _example({"x": 3.5, "y": 1.2, "z": -0.4})
STEREO_EXAMPLE = _example({"u_left": 327.0, "v_left": 279.0, "u_right": 285.5, "v_right": 279.0})
PINHOLE_EXAMPLE = _example({"u": 327.0, "v": 279.0})


class Cartesian3dRows(Wire):
    """A batch as rows, for a robot in space whose observations are points."""

    model_config = ConfigDict(json_schema_extra={"examples": [CARTESIAN3D_EXAMPLE]})

    sequence: Sequence
    steps: Annotated[list[Cartesian3dStep], FAIL_FAST] = Field(min_length=1, description=Steps)


class StereoRows(Wire):
    """A batch as rows, for a robot in space with a pair of cameras."""

    model_config = ConfigDict(json_schema_extra={"examples": [STEREO_EXAMPLE]})

    sequence: Sequence
    steps: Annotated[list[StereoStep], FAIL_FAST] = Field(min_length=1, description=Steps)


class PinholeRows(Wire):
    """A batch as rows, for a robot in space with one camera."""

    model_config = ConfigDict(json_schema_extra={"examples": [PINHOLE_EXAMPLE]})

    sequence: Sequence
    steps: Annotated[list[PinholeStep], FAIL_FAST] = Field(min_length=1, description=Steps)


SpatialRows = Cartesian3dRows | StereoRows | PinholeRows
