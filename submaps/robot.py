"""One robot's place in a map: its models, its clock, its dead reckoning, its active sub-map."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from submaps.atlas.state import RobotState
from submaps.config import MapConfig, RobotConfig
from submaps.consistency import chi_square_bound
from submaps.encounters import Columns
from submaps.filtering import layout
from submaps.measurements import Floats, Ints
from submaps.observation.models import MODELS, body_sensor, sensor_of
from submaps.submap import ActiveSubmap

FLAG_PROBABILITY = 0.9999
# Steps of an active sub-map that are kept, so that a sighting of the robot that comes late can still be marked.
KEPT_STEPS = 5_000
_LOOSE_SEGMENTS = 32


@dataclass(frozen=True)
class Segment:
    """Columns that an active sub-map has taken in, and the time of the step before them, if there is one."""

    columns: Columns
    before: float | None

    def covers(self, t: float) -> bool:
        """Whether a mark at t (s) can be put among them."""
        first = float(self.columns.t[0]) if self.before is None else self.before
        return (first < t or (self.before is None and t == first)) and t <= float(self.columns.t[-1])


class Robot:
    """What a mapper keeps of one robot."""

    def __init__(self, number: int, name: str, config: MapConfig, own: RobotConfig, active: ActiveSubmap) -> None:
        self.number = number
        self.name = name
        self.motion = own.motion
        self.start = own.start
        self.whole, self.real, self.R = _settings(config, own)
        self.endless = self.whole.copy()  # for walking a sub-map again, which is not to end
        self.endless[[layout.MAX_LANDMARKS, layout.MIN_OBSERVED]] = 1 << 40
        self.active = active
        self.first = active.number
        self.t: float | None = None
        pose = config.geometry.pose
        self.odom = np.zeros(pose)
        self.odom_covariance = np.zeros((pose, pose))
        self.closed_counts = np.zeros(3, dtype=np.int64)  # steps, observations, rejected
        self.foreign: set[int] = set()  # landmarks that a robot of another component saw first
        self.history: list[Segment] | None = []

    def remember(self, columns: Columns, began: int | None) -> None:
        """Keep what the active sub-map has taken in; ``began`` is the step of these at which it did, if any."""
        if began is not None:
            self.history = [Segment(columns.since(began), None)]
        elif self.history is not None:
            self.history.append(Segment(columns, self.t))
            if len(self.history) > _LOOSE_SEGMENTS:
                whole = self.history[0].columns
                for segment in self.history[1:]:
                    whole = whole.then(segment.columns)
                self.history = [Segment(whole, self.history[0].before)] if whole.t.shape[0] < KEPT_STEPS else None

    def state(self) -> RobotState:
        """What a view tells of it."""
        own = [layout.STEPS, layout.OBSERVATIONS, layout.REJECTED]
        steps, observations, rejected = (self.closed_counts + self.active.counts[own]).tolist()
        odom = None if self.whole[layout.MOTIONLESS] else self.active.space.as_pose(self.odom)
        return RobotState(
            id=self.name, number=self.number, first=self.first, submap=self.active.number, t=self.t or 0.0,
            steps=steps, observations=observations, rejected=rejected, pose=self.active.pose,
            odom=odom, odom_covariance=self.odom_covariance.copy(), start=self.start, channels=self.R.shape[1],
        )  # fmt: skip


def _settings(config: MapConfig, own: RobotConfig) -> tuple[Ints, Floats, Floats]:
    """Integer and real settings (``filtering.layout``), and the covariance (1, c, c) of a reading."""
    observation, space = own.observation, config.geometry
    channels = len(observation.channels)
    gate = math.inf if config.gate is None else chi_square_bound(config.gate, channels)
    flag = chi_square_bound(FLAG_PROBABILITY, channels)
    motionless = own.motion.model == "none"
    whole = [
        MODELS[observation.model], config.filter == "invariant", config.max_landmarks, config.min_observed_steps,
        motionless,
    ]  # fmt: skip
    bounds = np.array([gate, flag, config.max_heading_sigma**2, config.max_position_sigma**2])
    real = np.concatenate([bounds, sensor_of(space, observation), body_sensor(space)])
    return np.array(whole, dtype=np.int64), real, np.diag(np.square(observation.sigma))[np.newaxis]
