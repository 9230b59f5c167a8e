"""The main path: a batch walks through one robot's active sub-map, and on into the next.

Steps are taken in order: predict, associate, update, augment. The compiled walk comes back here only
where a sub-map is full or its arrays have to grow, and, where observations do not name their
landmarks, before each step that has some (``associating``).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from submaps.associating import AMBIGUOUS_STATUS, Associator
from submaps.atlas.solution import Solution
from submaps.atlas.state import AtlasState, submap_of
from submaps.atlas.view import View
from submaps.config import MapConfig, RobotConfig, Start
from submaps.encounters import Columns, Mark, one_each, with_marks
from submaps.filtering import kernel, layout
from submaps.filtering.closing import Shelf
from submaps.filtering.walk import walk
from submaps.landmarks import LandmarkTable
from submaps.measurements import Batch, Floats, Ints, Rejection, Report
from submaps.motion.increments import dead_reckon, increments
from submaps.robot import Robot, Segment
from submaps.submap import ActiveSubmap, Submap

# Sub-maps that only extend the solution may wait this long for the next solve.
PENDING_EXTENSIONS = 8
# Landmarks that a robot's first arrays have room for, and sub-maps that a first shelf has: both grow.
_FIRST_CAPACITY = 13
_SHELF_SUBMAPS, _SHELF_REALS, _MOST_SHELVED = 4, 1 << 11, 256
# Sightings of one robot that wait for it to come so far.
_MOST_MARKS = 10_000
_REASONS = {
    kernel.GATED: "gate",
    kernel.SINGULAR: "singular",
    kernel.FLAGGED: "unlikely",
    kernel.LATE: "late",
    kernel.LOST: "lost",
    AMBIGUOUS_STATUS: "ambiguous",
}


class Mapper:
    """One map of any number of robots; changed by one thread at a time.

    ``solve_due`` says that a sub-map closed which ties to older ones, that several have closed, or
    that robots may have met, since the last call of ``problem``.
    """

    def __init__(self, config: MapConfig) -> None:
        self.config = config
        self.solve_due = False
        self._pending = 0
        self._closed_bytes = 0
        self._invariant = config.filter == "invariant"
        self._configured: dict[str, RobotConfig] = {}
        self._robots: dict[str, Robot] = {}
        self._roots = np.empty(0, dtype=np.int64)
        self._shelf = Shelf(_SHELF_SUBMAPS, _SHELF_REALS)
        self._marks: dict[str, list[Mark]] = {}  # of robots that have not come so far yet
        self._state = AtlasState.empty(config)
        self._landmarks = LandmarkTable(self._state.names, self._state.number_of, self._state.sightings)
        self._changed: set[str] = set()
        self._associator: Associator | None = None
        if not config.named:
            self._associator = Associator(config, self._landmarks, self._state.records)

    def configure(self, robot: str, own: RobotConfig) -> None:
        """Set a robot apart from the map's defaults, before its first batch."""
        self._configured[robot] = own

    def apply(self, robot: str, batch: Batch) -> Report:
        """Take in an admitted batch of one robot's measurements; never fails on its content."""
        r = self._robots.get(robot) or self._new_robot(robot, float(batch.t[0]))
        landmark, met = (self._associator or self._landmarks).intern(batch.landmark)
        columns, track_odom = _prepared(r, batch, landmark)
        late = self._announce(met)
        marks = self._due_marks(robot, float(batch.t[-1]))
        marked = None
        if late:
            taken = np.isin(landmark, late, invert=True)
            columns = columns.only(taken)
        if marks:
            marked = with_marks(columns, r.t, marks)
            columns = marked.columns
        before, number = r.active.number, columns.landmark
        if self._associator is None:
            track, track_submap, seen_status, seen_nis = self._walk(r, columns)
        else:
            found = self._associator.walk(r, columns, self._walk)
            columns, number = found.columns, found.number
            track, track_submap, seen_status, seen_nis = found.walked
        self._note(r, columns, before, track_submap)
        if marked is not None:
            track, track_submap = track[marked.steps], track_submap[marked.steps]
            seen_status, seen_nis = seen_status[marked.observations], seen_nis[marked.observations]
            number = number[marked.observations]
        status, nis = seen_status, seen_nis
        if late:
            status = np.full(batch.observations, kernel.LATE, dtype=np.uint8)
            nis = np.full(batch.observations, math.nan)
            status[taken], nis[taken], landmark[taken] = seen_status, seen_nis, number
        elif self._associator is not None:
            landmark = number
        names, found_ = batch.landmark, None
        if self._associator is not None:
            names, found_ = self._associator.told(batch.landmark, landmark, status)
        rejected, flagged = _set_aside(batch, names, status, nis)
        pose, t = r.active.space.as_pose(track[-1]), float(batch.t[-1])
        return Report(r.active.number, t, pose, rejected, flagged, track_submap, track, track_odom, found_)

    def _walk(self, r: Robot, c: Columns) -> tuple[Floats, NDArray[np.int32], NDArray[np.uint8], Floats]:
        """Walk through the robot's sub-maps: pose and sub-map after each step, status and nis of each observation."""
        nis = np.empty(c.landmark.shape[0])
        status = np.zeros(c.landmark.shape[0], dtype=np.uint8)
        track = np.empty((c.t.shape[0], r.active.space.pose))
        track_submap, chapter = np.empty((2, c.t.shape[0]), dtype=np.int32)
        event, step, resumed = layout.GENESIS, 0, False
        while event != layout.DONE:
            s, begin, shelf = r.active, step, self._shelf
            self._landmarks.lend_slots(s)
            event, step = walk(
                s.space.key, step, resumed, c.increments, c.noises, c.control_step, c.observation_step, c.landmark, c.z,
                c.R, c.own, r.whole, r.real, s.x, s.P, s.ids, s.counts, s.motion, self._landmarks.slot_of, s.scratch,
                nis, status, track, chapter, shelf.whole, shelf.reals, shelf.ids, shelf.fill,
            )  # fmt: skip
            numbers = [s.number]
            # Without motion a sub-map closes in additive errors (``filtering.closing``).
            invariant = self._invariant and not r.whole[layout.MOTIONLESS]
            for closed in s.closed(shelf, invariant, c.t, iter(self._next_number, None)):
                self._file(r, closed)
                numbers.append(closed.following)
            track_submap[begin:step] = np.array(numbers, dtype=np.int32)[chapter[begin:step]]
            resumed = True
            if event == layout.GENESIS and (len(numbers) == 1 or shelf.whole.shape[0] < _MOST_SHELVED):
                self._shelf = shelf.twice()
            elif event == layout.GROW:
                s.grow(int(np.count_nonzero(c.observation_step == step)) + s.landmark_count)
        return track, track_submap, status, nis

    def _note(self, r: Robot, columns: Columns, before: int, track_submap: NDArray[np.int32]) -> None:
        """Note what columns have changed beside the sub-maps; ``before`` is the sub-map that was active."""
        if len(self._robots) > 1:
            self._note_foreign(r, columns.landmark)
        fresh = r.active.number != before
        r.remember(columns, int(np.argmax(track_submap == r.active.number)) if fresh else None)
        r.t = float(columns.t[-1])
        self._changed.add(r.name)

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
        state, roots = self._state, solution.roots
        since = [roots[r] if r < len(roots) else r for r in self._roots[len(roots) :].tolist()]
        self._roots = np.array([*roots, *since], dtype=np.int64)
        untied = frozenset() if state.solution is None else state.solution.untied
        # Edges are kept once their sub-maps are closed, as long as the same ties hold.
        settled = state.settled if roots == state.roots[: len(roots)] and untied == solution.untied else {}
        self._state = replace(state, solution=solution, version=state.version + 1, settled=settled)

    # -- robots, landmarks, sub-maps ---------------------------------------------------------

    def _new_robot(self, name: str, t: float) -> Robot:
        number = len(self._robots)
        if number == 1:
            self._landmarks.all_seen_by(0)
        capacity = min(self.config.max_landmarks, _FIRST_CAPACITY)
        own = self._configured.get(name) or RobotConfig(self.config.motion, self.config.observation)
        active = ActiveSubmap(self._next_number(), number, t, capacity, self.config.geometry)
        robot = Robot(number, name, self.config, own, active)
        self._robots[name] = robot
        root = number if own.start is None else self._root_of(own.start)
        self._roots = np.append(self._roots, min(root, number))
        return robot

    def _root_of(self, start: Start) -> int:
        """The root of the component that a start's frame is in."""
        number = submap_of(start.frame)
        if number is None:
            return 0
        record = self._state.records[number]
        holders = (r.number for r in self._robots.values() if r.active.number == number)
        return int(self._roots[next(holders) if record is None else record.robot])

    def _next_number(self) -> int:
        """The number of a sub-map that begins, with a place for it among the records."""
        self._state.records.append(None)
        return len(self._state.records) - 1

    def _file(self, r: Robot, closed: Submap) -> None:
        """Put a sub-map that has closed among the records."""
        self._state.records[closed.number] = closed
        self._closed_bytes += closed.nbytes
        r.closed_counts += (closed.steps, closed.observations, closed.rejected)
        self._pending += 1
        self.solve_due |= self._landmarks.file(closed) or self._pending >= PENDING_EXTENSIONS

    def _note_foreign(self, r: Robot, landmark: Ints) -> None:
        """Ask for a solve where the robot sees landmarks that another component's robots saw first."""
        before = len(r.foreign)
        r.foreign.update(self._landmarks.foreign(landmark, r.number, self._roots))
        self.solve_due |= len(r.foreign) > max(before, 1)

    # -- robots that see one another ---------------------------------------------------------

    def _announce(self, met: list[tuple[str, float, int]]) -> list[int]:
        """Tell robots when they were seen; the numbers of encounters that come too late for that."""
        passed: dict[str, list[Mark]] = {}
        for name, t, number in met:
            other = self._robots.get(name)
            ahead = other is not None and other.t is not None and t <= other.t
            (passed if ahead else self._marks).setdefault(name, []).append((t, number))
            if not ahead and len(self._marks[name]) > _MOST_MARKS:
                del self._marks[name][0]
        return [number for name, marks in passed.items() for number in self._mark_late(self._robots[name], marks)]

    def _due_marks(self, robot: str, until: float) -> list[Mark]:
        """Take the marks that a robot passes."""
        waiting = self._marks.get(robot)
        if not waiting:
            return []
        self._marks[robot] = [mark for mark in waiting if mark[0] > until]
        return [mark for mark in waiting if mark[0] <= until]

    def _mark_late(self, r: Robot, marks: list[Mark]) -> list[int]:
        """Walk the active sub-map again with marks in it; the numbers of those that came too late."""
        s, history = r.active, r.history
        room = max(2 * self.config.max_landmarks - s.landmark_count, 0)
        good = [mark for mark in marks if history and any(segment.covers(mark[0]) for segment in history)][:room]
        if history and good:
            fresh = ActiveSubmap(s.number, s.robot, s.began, s.landmark_count + len(good), s.space)
            fresh.previous = s.previous
            self._landmarks.lend_slots(fresh)
            parts = [(segment, [m for m in good if segment.covers(m[0])]) for segment in history]
            r.history = [self._walk_again(r, fresh, segment, own) for segment, own in parts]
            r.active = fresh
            self._changed.add(r.name)
        kept = {number for _, number in good}
        return [number for _, number in marks if number not in kept]

    def _walk_again(self, r: Robot, s: ActiveSubmap, segment: Segment, marks: list[Mark]) -> Segment:
        """Take a segment into a sub-map once more, with marks, and without ending it."""
        c = segment.columns
        if marks:
            c = with_marks(c, segment.before, marks).columns
        m, n, shelf = c.landmark.shape[0], c.t.shape[0], self._shelf
        walk(
            s.space.key, 0, False, c.increments, c.noises, c.control_step, c.observation_step, c.landmark, c.z, c.R,
            c.own, r.endless, r.real, s.x, s.P, s.ids, s.counts, s.motion, self._landmarks.slot_of, s.scratch,
            np.empty(m), np.empty(m, dtype=np.uint8), np.empty((n, s.space.pose)), np.empty(n, dtype=np.int32),
            shelf.whole, shelf.reals, shelf.ids, shelf.fill,
        )  # fmt: skip
        return Segment(c, segment.before)

    # -- what is shared with views -----------------------------------------------------------

    def _publish(self) -> None:
        if not self._changed and self._state.submap_count == len(self._state.records):
            return
        active, robots = dict(self._state.active), dict(self._state.robots)
        for name in sorted(self._changed):
            r = self._robots[name]
            if name in robots:
                active.pop(robots[name].submap, None)
            active[r.active.number] = r.active.snapshot(r.t or 0.0, self._invariant)
            robots[name] = r.state()
        self._changed.clear()
        self._state = replace(
            self._state, active=active, robots=robots, submap_count=len(self._state.records),
            landmark_count=len(self._state.names), encounter_count=self._landmarks.encounters,
            closed_bytes=self._closed_bytes,
        )  # fmt: skip


def _prepared(r: Robot, batch: Batch, landmark: Ints) -> tuple[Columns, Floats]:
    """A batch as the walk takes it, and the robot's track by dead reckoning, which it brings forward."""
    steps, noises = increments(r.motion, batch, r.t)
    space = r.active.space
    track_odom = np.empty((batch.steps, space.pose))
    dead_reckon(space.key, r.odom, r.odom_covariance, steps, noises, batch.control_step, track_odom)
    R = r.R if batch.observation_covariance is None else one_each(batch.observation_covariance)
    own = np.zeros(batch.observations, dtype=np.uint8)
    columns = Columns(
        batch.t, batch.control_step, steps, noises, batch.observation_step, landmark, batch.z, R, own
    )  # fmt: skip
    return columns, track_odom


def _set_aside(
    batch: Batch, names: tuple[str, ...], status: NDArray[np.uint8], nis: Floats
) -> tuple[tuple[Rejection, ...], tuple[Rejection, ...]]:
    rejected: list[Rejection] = []
    flagged: list[Rejection] = []
    for i in np.flatnonzero((status != kernel.USED) & (status != kernel.FIRST)):
        step = int(batch.observation_step[i])
        within = int(i - np.searchsorted(batch.observation_step, step))
        value = float(nis[i]) if math.isfinite(nis[i]) else None
        entry = Rejection(step, within, names[i], _REASONS[int(status[i])], value)
        (flagged if status[i] == kernel.FLAGGED else rejected).append(entry)
    return tuple(rejected), tuple(flagged)
