"""Messages about maps: what a map is made of, and what is told of it."""

from __future__ import annotations

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


class Motion(Wire):
    """What all motion models share."""

    noise: Literal["reading"] = Field("reading", exclude=True, description="sigma is of one step's reading")


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


AnyMotion: TypeAlias = Annotated[OdometryMotion | VelocityMotion, Field(discriminator="model")]

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
        mount = self.observation.mount
        try:
            return MapConfig(
                motion=MotionConfig(self.motion.model, tuple(self.motion.sigma)),
                observation=ObservationConfig(
                    self.observation.model,
                    (self.observation.sigma[0], self.observation.sigma[1]),
                    (mount[0], mount[1], mount[2]),
                ),
                filter=self.filter,
                gate=self.association.gate,
                max_landmarks=self.submap.max_landmarks,
                max_heading_sigma=self.submap.max_heading_sigma,
                max_position_sigma=self.submap.max_position_sigma,
                min_observed_steps=self.submap.min_observed_steps,
            )
        except ConfigError as error:
            raise invalid(error.field, f"got {error.got!r}, expected {error.expected}") from error


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
    observations: int
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
