"""Messages about maps: what a map is made of, and what is told of it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import ConfigDict, Field, TypeAdapter

from service.problems import invalid
from service.wire.base import LARGEST, Name, Number, Wire
from submaps.config import MapConfig, MotionConfig, ObservationConfig
from submaps.errors import ConfigError

Sigma = Annotated[float, Field(ge=0, le=LARGEST)]
# Squares of anything smaller are lost beside the other numbers of a covariance.
PositiveSigma = Annotated[float, Field(ge=1e-6, le=LARGEST)]
Count = Annotated[int, Field(ge=1)]


# m. The heading changes by its reciprocal.
Wheelbase = Annotated[float, Field(ge=1e-3, le=LARGEST)]


def _is_reading(noise: str) -> bool:
    return noise == "reading"


class Motion(Wire):
    """What all motion models share."""

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
    wheelbase: Wheelbase = Field(description="m, from the rear wheel to the front wheel", examples=[1.0])


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
    wheelbase: Wheelbase = Field(description="m, from the rear axle to the front axle", examples=[2.83])
    encoder_offset: Number = Field(
        0.0,
        description="m, from the middle of the rear axle to the encoder's wheel, above 0 to the left; "
        "less than the wheelbase",
        examples=[0.76],
    )


class Observation(Wire):
    """A point landmark seen from the sensor."""

    model: Literal["cartesian", "range_bearing"]
    sigma: list[PositiveSigma] = Field(
        min_length=2, max_length=2, description="m, m or m, rad", examples=[[0.6325, 0.6325]]
    )
    mount: list[Number] = Field(
        default=[0.0, 0.0, 0.0],
        min_length=3,
        max_length=3,
        description="the sensor's pose in the body frame: m, m, rad",
    )


class Association(Wire):
    """How an observation finds its landmark."""

    method: Literal["known"] = Field("known", description="each observation names its landmark")
    gate: Annotated[float, Field(gt=0, lt=1)] | None = Field(
        None, description="chi-square probability beyond which an observation is rejected"
    )


class Submap(Wire):
    """When a sub-map closes."""

    max_landmarks: Annotated[int, Field(ge=1, le=1000)] = 50
    max_heading_sigma: Annotated[float, Field(gt=0, le=LARGEST, description="rad")] = 0.010
    max_position_sigma: Annotated[float, Field(gt=0, le=LARGEST, description="m")] = 0.15
    min_observed_steps: Annotated[int, Field(ge=1, le=1_000_000)] = 5


AnyMotion: TypeAlias = Annotated[
    OdometryMotion | VelocityMotion | BicycleMotion | AckermannMotion, Field(discriminator="model")
]


def motion_to_core(motion: AnyMotion) -> MotionConfig:
    """Return the estimator's motion model; raises ``Problem`` (422) where it refuses a value."""
    wheelbase = motion.wheelbase if isinstance(motion, BicycleMotion | AckermannMotion) else None
    offset = motion.encoder_offset if isinstance(motion, AckermannMotion) else 0.0
    with refusals():
        return MotionConfig(motion.model, tuple(motion.sigma), motion.noise, wheelbase, offset)


def observation_to_core(observation: Observation) -> ObservationConfig:
    """Return the estimator's observation model; raises ``Problem`` (422) where it refuses a value."""
    x, y, theta = observation.mount
    with refusals():
        return ObservationConfig(observation.model, tuple(observation.sigma), (x, y, theta))


@contextmanager
def refusals() -> Iterator[None]:
    """Turn what the estimator refuses into a ``Problem`` (422)."""
    try:
        yield
    except ConfigError as error:
        raise invalid(error.field, f"got {error.got!r}, expected {error.expected}") from error


EXAMPLE: dict[str, Any] = {
    "motion": {"model": "odometry", "sigma": [0.01, 0.002, 0.002]},
    "observation": {"model": "cartesian", "sigma": [0.6325, 0.6325], "mount": [0, 0, 0]},
    "filter": "invariant",
    "association": {"method": "known", "gate": None},
    "submap": {"max_landmarks": 50, "max_heading_sigma": 0.010, "max_position_sigma": 0.15, "min_observed_steps": 5},
}


class Config(Wire):
    """What a map estimates with; fixed for its life."""

    model_config = ConfigDict(json_schema_extra={"examples": [EXAMPLE]})

    motion: AnyMotion
    observation: Observation
    filter: Literal["invariant", "standard"] = "invariant"
    association: Association = Field(default_factory=lambda: Association.model_validate({}))
    submap: Submap = Field(default_factory=lambda: Submap.model_validate({}))

    def to_core(self) -> MapConfig:
        """Return the estimator's configuration.

        Raises ``Problem`` (422) where the estimator refuses a value.
        """
        motion, observation = motion_to_core(self.motion), observation_to_core(self.observation)
        with refusals():
            return MapConfig(
                motion=motion,
                observation=observation,
                filter=self.filter,
                gate=self.association.gate,
                max_landmarks=self.submap.max_landmarks,
                max_heading_sigma=self.submap.max_heading_sigma,
                max_position_sigma=self.submap.max_position_sigma,
                min_observed_steps=self.submap.min_observed_steps,
            )


class MapRequest(Config):
    """A map to be made; without an id, one is generated."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"id": "park", **EXAMPLE}]})

    id: Name | None = None

    def config(self) -> Config:
        """Return the configuration without the id."""
        return Config(**{name: getattr(self, name) for name in Config.model_fields})


class Counts(Wire):
    """How much a map holds."""

    robots: int
    steps: int
    observations: int = Field(description="that were used, encounters included")
    rejected: int
    landmarks: int
    submaps: int
    edges: int
    bytes: int = Field(description="memory of the estimate")


ANSWER: dict[str, Any] = {
    "id": "park",
    "config": EXAMPLE,
    "counts": {"robots": 1, "steps": 6969, "observations": 3640, "rejected": 0, "landmarks": 151, "submaps": 269,
               "edges": 412, "bytes": 1048576},
    "map_version": 12,
}  # fmt: skip


class MapAnswer(Wire):
    """A map."""

    model_config = ConfigDict(json_schema_extra={"examples": [ANSWER]})

    id: Name
    config: Config
    counts: Counts
    map_version: int = Field(description="rises with each published solve")


class MapList(Wire):
    """A page of the maps, oldest first."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"maps": [ANSWER], "next": None}]})

    maps: list[MapAnswer]
    next: str | None = Field(description="cursor of the next page")


CONFIG = TypeAdapter(Config)
MAP_REQUEST = TypeAdapter(MapRequest)
