"""A recorded run of one robot or of several, whatever files it came from."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from submaps.config import MapConfig, MotionConfig, ObservationConfig
from submaps.measurements import Batch, Floats
from submaps.trajectory import Trajectory

ROBOT = "robot"
WINDOW_SECONDS = 2.0


class DatasetError(Exception):
    """A data set cannot be read; the message names the file, the line and what was expected."""


@dataclass(frozen=True)
class Truth:
    """What is known of a run from outside, in one frame of its own.

    ``landmarks`` by id, (2,) in m; ``trajectories`` by robot, on the clock of the measurements.
    """

    landmarks: Mapping[str, Floats]
    trajectories: Mapping[str, Trajectory] = field(default_factory=dict)


@dataclass(frozen=True)
class Dataset:
    """A run: the map's settings with their noise, and each robot's measurements as one batch of columns.

    Robots share one clock. ``notes`` count what a reader had to mend or to leave out.
    """

    name: str
    config: MapConfig
    robots: Mapping[str, Batch]
    truth: Truth | None = None
    notes: Mapping[str, int] = field(default_factory=dict)

    @staticmethod
    def single(name: str, motion: MotionConfig, observation: ObservationConfig, columns: Batch) -> Dataset:
        """A run of one robot, with the default settings."""
        return Dataset(name, MapConfig(motion, observation), {ROBOT: columns})

    @property
    def motion(self) -> MotionConfig:
        """The motion model of all robots."""
        return self.config.motion

    @property
    def observation(self) -> ObservationConfig:
        """The observation model of all robots."""
        return self.config.observation

    @property
    def columns(self) -> Batch:
        """The measurements of a run of one robot; raises ``ValueError`` where there are several."""
        (columns,) = self.robots.values()
        return columns

    @property
    def steps(self) -> int:
        """Number of steps of all robots."""
        return sum(batch.steps for batch in self.robots.values())

    @property
    def observations(self) -> int:
        """Number of observations of all robots, sightings of one another included."""
        return sum(batch.observations for batch in self.robots.values())

    def batches(
        self, max_observations: int = 1000, max_steps: int = 5000, window: float = WINDOW_SECONDS
    ) -> Iterator[tuple[str, Batch]]:
        """Cut the run into batches with their robots, none above either bound, in the order of their ends.

        Where there are several robots, no batch reaches across a multiple of ``window`` (s), so that
        they take turns as they would live. A step is never split, so a single step with more
        observations makes a batch of its own.
        """
        several = len(self.robots) > 1
        queues = []
        for number, (robot, columns) in enumerate(self.robots.items()):
            stops = _stops(columns, max_observations, max_steps, window if several else math.inf)
            spans = zip([0, *stops[:-1]], stops, strict=True)
            queues.append([(float(columns.t[stop - 1]), number, robot, start, stop) for start, stop in spans])
        for _, _, robot, start, stop in heapq.merge(*queues):
            yield robot, cut(self.robots[robot], start, stop)


def _stops(columns: Batch, max_observations: int, max_steps: int, window: float) -> list[int]:
    """The steps before which a robot's run is cut."""
    observed = columns.observation_step
    stops: list[int] = []
    start = 0
    while start < columns.steps:
        first = int(np.searchsorted(observed, start))
        stop = min(start + max_steps, columns.steps)
        if first + max_observations < observed.shape[0]:
            stop = min(stop, int(observed[first + max_observations]))
        if math.isfinite(window):
            end = window * (math.floor(float(columns.t[start]) / window) + 1)
            stop = min(stop, int(np.searchsorted(columns.t, end)))
        start = max(stop, start + 1)
        stops.append(start)
    return stops


def cut(batch: Batch, start: int, stop: int) -> Batch:
    """Steps ``start`` to ``stop`` (exclusive) of a batch, with their step numbers from zero."""
    controls = _span(batch.control_step, start, stop)
    seen = _span(batch.observation_step, start, stop)
    control_covariance = batch.control_covariance
    observation_covariance = batch.observation_covariance
    return Batch(
        t=batch.t[start:stop].copy(),
        control_step=batch.control_step[controls] - start,
        control=np.ascontiguousarray(batch.control[:, controls]),
        control_covariance=None if control_covariance is None else control_covariance[controls].copy(),
        observation_step=batch.observation_step[seen] - start,
        landmark=batch.landmark[seen],
        z=np.ascontiguousarray(batch.z[:, seen]),
        observation_covariance=None if observation_covariance is None else observation_covariance[seen].copy(),
    )


def _span(steps: np.ndarray, start: int, stop: int) -> slice:
    first, last = np.searchsorted(steps, [start, stop])
    return slice(int(first), int(last))
