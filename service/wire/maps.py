"""Messages about maps: what a map is made of, and what is told of it."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, TypeAdapter, model_validator

from service.wire.base import LARGEST, Name, Wire
from service.wire.models import AnyMotion, Observation, motion_to_core, observation_to_core, refusals
from submaps.config import DEFAULT_GATE, DEFAULT_NEW_GATE, AssociationName, MapConfig, SpaceName


def _is_plane(space: str) -> bool:
    return space == "se2"


def _is_absent(gate: float | None) -> bool:
    return gate is None


class Association(Wire):
    """How an observation finds its landmark.

    With another method than `known` observations come without `landmark`, and `gate` and `new_gate` have
    defaults, which the map keeps.
    """

    method: AssociationName = Field(
        "known",
        description="`known`: each observation names its landmark; `greedy`: the likeliest pair first; `assignment`: "
        "the likeliest pairs of a step as a whole; `joint`: the most pairs of a step that fit together",
    )
    gate: Annotated[float, Field(gt=0, lt=1)] | None = Field(
        None,
        description="chi-square probability beyond which an observation is rejected; where landmarks are not named, "
        f"beyond which it is not of a landmark ({DEFAULT_GATE})",
    )
    new_gate: Annotated[float, Field(gt=0, lt=1)] | None = Field(
        None,
        exclude_if=_is_absent,
        description="where landmarks are not named: chi-square probability beyond which, from all landmarks, an "
        f"observation begins one ({DEFAULT_NEW_GATE}); between the two gates it is rejected as ambiguous",
    )

    @model_validator(mode="after")
    def _fill_in(self) -> Association:
        # Here and not where they are used: a map keeps the gates it was made with.
        if self.method != "known":
            self.gate = DEFAULT_GATE if self.gate is None else self.gate
            self.new_gate = DEFAULT_NEW_GATE if self.new_gate is None else self.new_gate
        return self


class Submap(Wire):
    """When a sub-map closes."""

    max_landmarks: Annotated[int, Field(ge=1, le=1000)] = 50
    max_heading_sigma: Annotated[float, Field(gt=0, le=LARGEST, description="rad")] = 0.010
    max_position_sigma: Annotated[float, Field(gt=0, le=LARGEST, description="m")] = 0.15
    min_observed_steps: Annotated[int, Field(ge=1, le=1_000_000)] = 5


EXAMPLE: dict[str, Any] = {
    "motion": {"model": "odometry", "sigma": [0.01, 0.002, 0.002]},
    "observation": {"model": "cartesian", "sigma": [0.6325, 0.6325], "mount": [0, 0, 0]},
    "filter": "invariant",
    "association": {"method": "known", "gate": None},
    "submap": {"max_landmarks": 50, "max_heading_sigma": 0.010, "max_position_sigma": 0.15, "min_observed_steps": 5},
}


SPATIAL_EXAMPLE: dict[str, Any] = {
    "space": "se3",
    "motion": {"model": "odometry3d", "sigma": [0.01, 0.01, 0.01, 0.002, 0.002, 0.002]},
    "observation": {
        "model": "stereo", "sigma": [1.0, 1.0, 1.0, 1.0], "mount": [0.1, 0.0, 0.3, -0.5, 0.5, -0.5, 0.5],
        "camera": {"fu": 484.5, "fv": 484.5, "cu": 321.7, "cv": 247.5, "baseline": 0.24},
    },
}  # fmt: skip


class Config(Wire):
    """What a map estimates with; fixed for its life."""

    model_config = ConfigDict(json_schema_extra={"examples": [EXAMPLE, {**EXAMPLE, **SPATIAL_EXAMPLE}]})

    # Left out of answers where it says nothing, as `noise` is.
    space: SpaceName = Field(
        "se2",
        exclude_if=_is_plane,
        description="`se2`: a map of the plane; `se3`: of space. Left out of answers for `se2`",
    )
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
                association=self.association.method,
                gate=self.association.gate,
                new_gate=self.association.new_gate,
                max_landmarks=self.submap.max_landmarks,
                max_heading_sigma=self.submap.max_heading_sigma,
                max_position_sigma=self.submap.max_position_sigma,
                min_observed_steps=self.submap.min_observed_steps,
                space=self.space,
            )


class MapRequest(Config):
    """A map to be made; without an id, one is generated."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"id": "park", **EXAMPLE}, {"id": "room", **SPATIAL_EXAMPLE}]}
    )

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
