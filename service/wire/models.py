"""Messages about models: how robots move, and what their sensors see."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Literal, Self, TypeAlias

from pydantic import Field, model_validator

from service.problems import invalid
from service.wire.base import LARGEST, Number, Wire
from service.wire.poses import unit_quaternion
from submaps.config import Camera, Depth, MotionConfig, ObservationConfig, ObservationModel
from submaps.errors import ConfigError

Sigma = Annotated[float, Field(ge=0, le=LARGEST)]
# Squares of anything smaller are lost beside the other numbers of a covariance.
PositiveSigma = Annotated[float, Field(ge=1e-6, le=LARGEST)]
# m, or pixels of a focal length. The heading changes by a wheelbase's reciprocal.
Length = Annotated[float, Field(ge=1e-3, le=LARGEST)]

# Observations of points in space, and how many numbers a sensor's pose has there.
SPATIAL = ("cartesian3d", "stereo", "pinhole")
SPATIAL_MOUNT = 7


def _is_reading(noise: str) -> bool:
    return noise == "reading"


def _is_absent(value: object) -> bool:
    return value is None


# -- motion --------------------------------------------------------------------------------------


class Motion(Wire):
    """What all models of a motion that is measured share."""

    # Left out of answers where it says nothing: maps made before it came are answered as they were.
    noise: Literal["reading", "density"] = Field(
        "reading",
        exclude_if=_is_reading,
        description="sigma is that of one step's `reading`, or a `density` per root second: an increment's variance "
        "is then sigma² dt, and an interval may be split",
    )


class OdometryMotion(Motion):
    """Increments of the pose in the body frame."""

    model: Literal["odometry"]
    sigma: list[Sigma] = Field(
        min_length=3, max_length=3, description="dx m, dy m, dtheta rad", examples=[[0.01, 0.002, 0.002]]
    )


class VelocityMotion(Motion):
    """Forward and angular velocity, held for the step: an arc."""

    model: Literal["velocity"]
    sigma: list[Sigma] = Field(
        min_length=2,
        max_length=3,
        description="v m/s, omega rad/s and, if the vehicle slips, lateral m/s",
        examples=[[0.05, 0.01]],
    )


class BicycleMotion(Motion):
    """Speed and steer of a front wheel, whose contact point is where the robot is.

    x += s dt cos(psi + d), y += s dt sin(psi + d), psi += s dt sin(d) / wheelbase.
    """

    model: Literal["bicycle"]
    sigma: list[Sigma] = Field(min_length=2, max_length=2, description="speed m/s, steer rad", examples=[[0.1, 0.02]])
    wheelbase: Length = Field(description="m, from the rear wheel to the front wheel", examples=[1.0])


class AckermannMotion(Motion):
    """Speed of an encoder on a rear wheel and steer of the front; the robot is the middle of the rear axle.

    v = speed / (1 - tan(steer) encoder_offset / wheelbase), omega = v tan(steer) / wheelbase, held
    for the step: an arc.
    """

    model: Literal["ackermann"]
    sigma: list[Sigma] = Field(
        min_length=2,
        max_length=3,
        description="speed m/s, steer rad and, if the vehicle slips, lateral m/s",
        examples=[[0.1, 0.02]],
    )
    wheelbase: Length = Field(description="m, from the rear axle to the front axle", examples=[2.83])
    encoder_offset: Number = Field(
        0.0,
        description="m, from the middle of the rear axle to the encoder's wheel, above 0 to the left; "
        "less than the wheelbase",
        examples=[0.76],
    )


class Odometry3dMotion(Motion):
    """Increments of the pose in space, in the body frame: p += R d, R <- R exp(r)."""

    model: Literal["odometry3d"]
    sigma: list[Sigma] = Field(
        min_length=6,
        max_length=6,
        description="dx m, dy m, dz m, and the rotation vector's rx, ry, rz in rad",
        examples=[[0.01, 0.01, 0.01, 0.002, 0.002, 0.002]],
    )


class NoMotion(Wire):
    """Nothing is known of the motion: each pose is found from what is seen there.

    Only with observations that show a point whole, `stereo` and `cartesian3d`.
    """

    model: Literal["none"]


AnyMotion: TypeAlias = Annotated[
    OdometryMotion | VelocityMotion | BicycleMotion | AckermannMotion | Odometry3dMotion | NoMotion,
    Field(discriminator="model"),
]


def motion_to_core(motion: AnyMotion) -> MotionConfig:
    """Return the estimator's motion model; raises ``Problem`` (422) where it refuses a value."""
    if isinstance(motion, NoMotion):
        return MotionConfig(motion.model, ())
    wheelbase = motion.wheelbase if isinstance(motion, BicycleMotion | AckermannMotion) else None
    offset = motion.encoder_offset if isinstance(motion, AckermannMotion) else 0.0
    with refusals():
        return MotionConfig(motion.model, tuple(motion.sigma), motion.noise, wheelbase, offset)


# -- observation ---------------------------------------------------------------------------------


class CameraModel(Wire):
    """A calibrated camera, or the left one of a pair: u = fu x / z + cu, v = fv y / z + cv."""

    fu: Length = Field(description="focal length across, px", examples=[484.5])
    fv: Length = Field(description="focal length down, px", examples=[484.5])
    cu: Number = Field(description="principal point, px from the left", examples=[321.7])
    cv: Number = Field(description="principal point, px from the top", examples=[247.5])
    baseline: Length | None = Field(
        None,
        exclude_if=_is_absent,
        description="m, from the left camera to the right one; for `stereo` only",
        examples=[0.24],
    )


class DepthPrior(Wire):
    """How far away a new landmark is taken to be, before a second reading tells: normal."""

    mean: PositiveSigma = Field(description="m", examples=[8.0])
    sigma: PositiveSigma = Field(description="m", examples=[4.0])


class Observation(Wire):
    """A point landmark seen from the sensor.

    In a map in se2 `cartesian`, `range_bearing` or `bearing`, in one in se3 `cartesian3d`, `stereo` or `pinhole`.
    """

    model: ObservationModel
    sigma: list[PositiveSigma] = Field(
        min_length=1,
        max_length=4,
        description="of one reading. `cartesian`: x m, y m; `range_bearing`: m, rad; `bearing`: rad; `cartesian3d`: "
        "x m, y m, z m; `stereo`: u_left, v_left, u_right, v_right px; `pinhole`: u, v px",
        examples=[[0.6325, 0.6325]],
    )
    mount: list[Number] = Field(
        default=[],
        max_length=7,
        description="the sensor's pose in the body frame: x m, y m, theta rad; in se3 x, y, z m and a unit quaternion "
        "x, y, z, w. If absent, the body's. A camera's frame has z ahead, x to the right, y down",
        examples=[[0.0, 0.0, 0.0]],
    )
    camera: CameraModel | None = Field(None, exclude_if=_is_absent, description="for `stereo` and `pinhole`")
    depth: DepthPrior | None = Field(
        None,
        exclude_if=_is_absent,
        description="prior of a new landmark's depth: of the range for `bearing`, along z for `pinhole`",
    )

    @model_validator(mode="after")
    def _with_mount(self) -> Self:
        """Fill in the mount that is meant where none is given: answers show it."""
        if "mount" not in self.model_fields_set:
            self.mount = [0.0] * 6 + [1.0] if self.model in SPATIAL else [0.0] * 3
        return self


def observation_to_core(observation: Observation) -> ObservationConfig:
    """Return the estimator's observation model; raises ``Problem`` (422) where it refuses a value."""
    camera, depth = observation.camera, observation.depth
    mount = tuple(observation.mount)
    if observation.model in SPATIAL and len(mount) == SPATIAL_MOUNT:
        mount = mount[:3] + unit_quaternion("observation.mount", mount[3:])
    if not mount:
        raise invalid("observation.mount", "got [], expected a pose, or no mount at all")
    with refusals():
        return ObservationConfig(
            observation.model,
            tuple(observation.sigma),
            mount,
            None if camera is None else Camera(camera.fu, camera.fv, camera.cu, camera.cv, camera.baseline or 0.0),
            None if depth is None else Depth(depth.mean, depth.sigma),
        )


@contextmanager
def refusals() -> Iterator[None]:
    """Turn what the estimator refuses into a ``Problem`` (422)."""
    try:
        yield
    except ConfigError as error:
        raise invalid(error.field, f"got {error.got!r}, expected {error.expected}") from error
