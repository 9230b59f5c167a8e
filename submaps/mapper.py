"""The main path: a batch walks through one robot's active sub-map, and on into the next.

Steps are taken in order: predict, associate (known ids), update, augment. The compiled walk
comes back here only where a sub-map is full or its arrays have to grow.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from submaps.atlas.solution import Solution
from submaps.atlas.state import AtlasState, RobotState
from submaps.atlas.view import View
from submaps.config import MapConfig, RobotConfig
from submaps.consistency import chi_square_bound
from submaps.filtering import kernel, layout
from submaps.filtering.closing import Shelf
from submaps.filtering.walk import walk
from submaps.geometry.trig import sincos
from submaps.measurements import Batch, Floats, Ints, Rejection, Report
from submaps.motion.increments import dead_reckon, increments
from submaps.observation.models import MODELS
from submaps.submap import ActiveSubmap, Submap

FLAG_PROBABILITY = 0.9999
# Sub-maps that only extend the solution may wait this long for the next solve.
PENDING_EXTENSIONS = 8
_FIRST_CAPACITY = 50
# Room for sub-maps that close within one walk, before it has to come back.
_SHELF_SUBMAPS, _SHELF_REALS = 256, 1 << 15
_REASONS = {kernel.GATED: "gate", kernel.SINGULAR: "singular", kernel.FLAGGED: "unlikely"}


class _Robot:
    """One robot's place in the map: its clock, its dead reckoning, its active sub-map."""

    def __init__(self, number: int, name: str, active: ActiveSubmap) -> None:
        self.number = number
        self.name = name
        self.active = active
        self.first = active.number
        self.t: float | None = None
        self.odom = np.zeros(3)
        self.odom_covariance = np.zeros((3, 3))
        self.closed_counts = np.zeros(3, dtype=np.int64)  # steps, observations, rejected


class Mapper:
    """One map of any number of robots; changed by one thread at a time.

    ``solve_due`` says that a sub-map closed which ties to older ones, or that several have closed,
    since the last call of ``problem``.
    """

    def __init__(self, config: MapConfig) -> None:
        self.config = config
        self.solve_due = False
        self._pending = 0
        self._closed_bytes = 0
        self._invariant = config.filter == "invariant"
        self._whole, self._real, self._R = _settings(config)
        self._robots: dict[str, _Robot] = {}
        self._slot_of = np.full(256, -1, dtype=np.int32)
        self._last_seen = np.full(256, -1, dtype=np.int32)
        self._slots_of: ActiveSubmap | None = None
        self._shelf = Shelf(_SHELF_SUBMAPS, _SHELF_REALS)
        self._state = AtlasState.empty(config)
        self._changed: set[str] = set()
        self._own: dict[str, RobotConfig] = {}

    def configure(self, robot: str, own: RobotConfig) -> None:
        """Set a robot apart from the map's defaults, before its first batch."""
        self._own[robot] = own

    def apply(self, robot: str, batch: Batch) -> Report:
        """Take in an admitted batch of one robot's measurements; never fails on its content."""
        r = self._robots.get(robot) or self._new_robot(robot, float(batch.t[0]))
        landmark = self._intern(batch.landmark)
        steps, noises = increments(self.config.motion, batch, r.t)
        track_odom = np.empty((batch.steps, 3))
        dead_reckon(r.odom, r.odom_covariance, steps, noises, batch.control_step, track_odom)
        R = self._R if batch.observation_covariance is None else _one_each(batch.observation_covariance)
        nis = np.empty(batch.observations)
        status = np.zeros(batch.observations, dtype=np.uint8)
        track = np.empty((batch.steps, 3))
        track_submap, chapter = np.empty((2, batch.steps), dtype=np.int32)
        shelf = self._shelf
        event, step, resumed = layout.GENESIS, 0, False
        while event != layout.DONE:
            s, begin = r.active, step
            self._lend_slots(s)
            event, step = walk(
                step, resumed, steps, noises, batch.control_step, batch.observation_step, landmark, batch.z, R,
                self._whole, self._real, s.x, s.P, s.ids, s.counts, s.motion, self._slot_of, s.scratch,
                nis, status, track, chapter, shelf.whole, shelf.reals, shelf.ids, shelf.fill,
            )  # fmt: skip
            numbers = [s.number]
            for closed in s.closed(shelf, self._invariant, batch.t, iter(self._next_number, None)):
                self._file(r, closed)
                numbers.append(closed.following)
            track_submap[begin:step] = np.array(numbers, dtype=np.int32)[chapter[begin:step]]
            resumed = True
            if event == layout.GENESIS and len(numbers) == 1:
                shelf = self._shelf = shelf.twice()
            elif event == layout.GROW:
                s.grow(int(np.count_nonzero(batch.observation_step == step)) + s.landmark_count)
        r.t = float(batch.t[-1])
        self._changed.add(robot)
        rejected, flagged = _set_aside(batch, status, nis)
        x, y, theta = track[-1]
        return Report(
            r.active.number, r.t, (float(x), float(y), float(theta)), rejected, flagged, track_submap, track, track_odom
        )

    def view(self) -> View:
        """What queries see: immutable, sharing all but the active sub-maps that changed."""
        self._publish()
        return View(self._state)

    def problem(self) -> AtlasState:
        """What a solve of this moment needs; clears ``solve_due``."""
        self._publish()
        self.solve_due = False
        self._pending = 0
        return self._state

    def install(self, solution: Solution) -> None:
        """Publish a solve: queries in ``map`` refer to it from now on."""
        self._state = replace(self._state, solution=solution, version=self._state.version + 1)

    # -- robots, landmarks, sub-maps ---------------------------------------------------------

    def _new_robot(self, name: str, t: float) -> _Robot:
        number = len(self._robots)
        capacity = min(self.config.max_landmarks, _FIRST_CAPACITY)
        robot = _Robot(number, name, ActiveSubmap(self._next_number(), number, t, capacity))
        self._robots[name] = robot
        return robot

    def _next_number(self) -> int:
        """The number of a sub-map that begins, with a place for it among the records."""
        self._state.records.append(None)
        return len(self._state.records) - 1

    def _file(self, r: _Robot, closed: Submap) -> None:
        """Put a sub-map that has closed among the records."""
        state = self._state
        state.records[closed.number] = closed
        self._closed_bytes += closed.nbytes
        r.closed_counts += (closed.steps, closed.observations, closed.rejected)
        held = closed.landmarks.tolist()
        for landmark in held:
            state.sightings[landmark].append(closed.number)
        seen = self._last_seen[held].tolist()
        self._last_seen[held] = closed.number
        self._pending += 1
        ties_to_older = any(k not in (-1, closed.previous) for k in seen)
        self.solve_due |= ties_to_older or self._pending >= PENDING_EXTENSIONS

    def _intern(self, names: tuple[str, ...]) -> Ints:
        """The map's numbers of landmark names; new names get the next ones."""
        state = self._state
        number_of = state.number_of
        try:
            return np.array([number_of[name] for name in names], dtype=np.int64)
        except KeyError:
            for name in names:
                if name not in number_of:
                    state.names.append(name)
                    state.sightings.append([])
                    number_of[name] = len(number_of)
        room = self._slot_of.shape[0]
        if len(number_of) > room:
            more = np.full(max(room, len(number_of) - room), -1, dtype=np.int32)
            self._slot_of = np.concatenate([self._slot_of, more])
            self._last_seen = np.concatenate([self._last_seen, more])
        return np.array([number_of[name] for name in names], dtype=np.int64)

    def _lend_slots(self, submap: ActiveSubmap) -> None:
        """Make the table from landmarks to slots speak of this sub-map."""
        if self._slots_of is submap:
            return
        if self._slots_of is not None:
            self._slot_of[self._slots_of.ids[: self._slots_of.landmark_count]] = -1
        held = submap.landmark_count
        self._slot_of[submap.ids[:held]] = 3 + 2 * np.arange(held, dtype=np.int32)
        self._slots_of = submap

    def _publish(self) -> None:
        if not self._changed and self._state.submap_count == len(self._state.records):
            return
        active, robots = dict(self._state.active), dict(self._state.robots)
        for name in sorted(self._changed):
            r = self._robots[name]
            if name in robots:
                active.pop(robots[name].submap, None)
            active[r.active.number] = r.active.snapshot(r.t or 0.0, self._invariant)
            robots[name] = _robot_state(r)
        self._changed.clear()
        self._state = replace(
            self._state, active=active, robots=robots, submap_count=len(self._state.records),
            landmark_count=len(self._state.names), closed_bytes=self._closed_bytes,
        )  # fmt: skip


def _settings(config: MapConfig) -> tuple[Ints, Floats, Floats]:
    observation = config.observation
    x, y, theta = observation.mount
    sine, cosine = sincos(theta)
    gate = math.inf if config.gate is None else chi_square_bound(config.gate, 2)
    flag = chi_square_bound(FLAG_PROBABILITY, 2)
    invariant = config.filter == "invariant"
    whole = [MODELS[observation.model], invariant, config.max_landmarks, config.min_observed_steps]
    real = [x, y, cosine, sine, gate, flag, config.max_heading_sigma**2, config.max_position_sigma**2]
    return np.array(whole, dtype=np.int64), np.array(real), np.diag(np.square(observation.sigma))[np.newaxis]


def _one_each(covariance: Floats) -> Floats:
    """One covariance for each observation; a single one would read as the model's for all."""
    return covariance if covariance.shape[0] != 1 else np.repeat(covariance, 2, axis=0)


def _robot_state(r: _Robot) -> RobotState:
    own = [layout.STEPS, layout.OBSERVATIONS, layout.REJECTED]
    steps, observations, rejected = (r.closed_counts + r.active.counts[own]).tolist()
    x, y, theta = r.odom
    return RobotState(
        id=r.name, number=r.number, first=r.first, submap=r.active.number, t=r.t or 0.0,
        steps=steps, observations=observations, rejected=rejected, pose=r.active.pose,
        odom=(float(x), float(y), float(theta)), odom_covariance=r.odom_covariance.copy(),
    )  # fmt: skip


def _set_aside(
    batch: Batch, status: NDArray[np.uint8], nis: Floats
) -> tuple[tuple[Rejection, ...], tuple[Rejection, ...]]:
    rejected: list[Rejection] = []
    flagged: list[Rejection] = []
    for i in np.flatnonzero((status > kernel.USED) & (status < kernel.FIRST)):
        step = int(batch.observation_step[i])
        within = int(i - np.searchsorted(batch.observation_step, step))
        value = float(nis[i]) if math.isfinite(nis[i]) else None
        entry = Rejection(step, within, batch.landmark[i], _REASONS[int(status[i])], value)
        (flagged if status[i] == kernel.FLAGGED else rejected).append(entry)
    return tuple(rejected), tuple(flagged)
