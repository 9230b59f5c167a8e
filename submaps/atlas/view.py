"""Answers about an atlas at one moment: poses, landmarks, sub-maps, in any frame that is connected."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Iterator, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from submaps.atlas.coordinates import transformed
from submaps.atlas.estimates import LandmarkEstimate, PoseEstimate, SubmapState
from submaps.atlas.front import Front, advance, condition
from submaps.atlas.graph import Edge, Graph
from submaps.atlas.placed import Placed, additive_covariance
from submaps.atlas.state import AtlasState, RobotState, submap_of
from submaps.errors import NotConnected, UnknownName
from submaps.geometry.space import Pose, Space
from submaps.measurements import as_encounter
from submaps.submap import Submap

Floats = NDArray[np.float64]
Box = tuple[float, float, float, float]


class View:
    """An immutable view of a map; every query may run in any thread."""

    def __init__(self, state: AtlasState) -> None:
        self.state = state
        self._lock = threading.RLock()
        self._placed: dict[int, Placed] = {}
        self._outside: dict[int, int] = {}

    @cached_property
    def graph(self) -> Graph:
        """Relative transforms between sub-maps."""
        return Graph(self.state)

    @property
    def space(self) -> Space:
        """The plane or space that the map is of."""
        return self.state.space

    @property
    def version(self) -> int:
        """Rises with each published solve."""
        return self.state.version

    @property
    def submap_count(self) -> int:
        """How many sub-maps have begun."""
        return self.state.submap_count

    def counts(self) -> dict[str, int]:
        """Totals of the map; ``bytes`` is what the estimates take."""
        robots = self.state.robots.values()
        return {
            "robots": len(robots),
            "steps": sum(r.steps for r in robots),
            "observations": sum(r.observations for r in robots),
            "rejected": sum(r.rejected for r in robots),
            "landmarks": self.state.landmark_count - self.state.encounter_count,
            "submaps": self.state.submap_count,
            "edges": self.graph.edge_count(),
            "bytes": self.state.closed_bytes + sum(s.nbytes for s in self.state.active.values()),
        }

    def robots(self) -> list[RobotState]:
        """Every robot, in order of appearance."""
        return sorted(self.state.robots.values(), key=lambda r: r.number)

    # -- frames ------------------------------------------------------------------------------

    def placed(self, number: int) -> Placed:
        """Sub-map ``number`` in the frame of its component, conditioned on the last solution."""
        state, solution = self.state, self.state.solution
        submap = state.submap(number)
        if solution is not None and number < solution.base.submap_count:
            then = solution.base.submap(number)
            if then is submap or (then.active and submap.active and then.digest() == submap.digest()):
                return solution.placed(number)
        with self._lock:
            if number not in self._placed:
                self._placed[number] = condition(self._front(submap), submap).placed()
            return self._placed[number]

    def _front(self, submap: Submap) -> Front:
        """What the solution and the sub-maps since say of this sub-map's frame and landmarks."""
        solution = self.state.solution
        # What closed sub-maps leave to closed ones after them is the same for every later view.
        known = (self.state.settled if solution is None else solution.settled).setdefault("fronts", {})
        at, since = submap, [submap]
        while at.number not in known and at.previous >= 0 and not self._solved(at):
            at = self.state.submap(at.previous)
            since.append(at)
        if at.number in known:
            front: Front = known[at.number]
        elif solution is not None and self._solved(at):
            front = solution.front(at)
        else:
            front = self._first_front(at)
        for before, after in itertools.pairwise(reversed(since)):
            front = advance(front, before, after)
            if not after.active:
                known[after.number] = front
        return front

    def _solved(self, submap: Submap) -> bool:
        solution = self.state.solution
        return solution is not None and submap.number < solution.base.submap_count

    def _first_front(self, submap: Submap) -> Front:
        """That of a robot's first sub-map which no solve has seen."""
        start, space = self.state.fleet[submap.robot].start, self.space
        if start is None:
            return Front.first(space)
        pose, covariance = start.pose, np.array(start.covariance)
        k = submap_of(start.frame)
        if k is not None:
            base = self.placed(k)
            covariance = space.compose_covariance(base.frame, base.frame_covariance, pose, covariance)
            pose = space.compose(base.frame, pose)
        return Front.of_start(space, pose, covariance)

    def connected(self, robot: int) -> bool:
        """Whether a robot (by number) has a place in ``map``."""
        return self.state.roots[robot] == 0

    def _in_map(self, submap: Submap) -> None:
        if not self.connected(submap.robot):
            own, first = self.state.fleet[submap.robot].id, self.state.fleet[0].id
            raise NotConnected(f"no ties lead from robot {own!r} to 'map', the frame of robot {first!r}'s first pose")

    def frame_in(self, number: int, frame: str) -> Pose:
        """Mean of a sub-map's frame in ``map`` or ``submap/k``."""
        target = self._submap_of(frame)
        if target is not None:
            return self.transform(target, number)[0]
        submap = self.state.submap(number)
        self._in_map(submap)
        solution = self.state.solution
        if solution is not None and number < solution.base.submap_count:
            return self.space.as_pose(solution.frames[number])
        return self.placed(number).frame

    def _submap_of(self, frame: str) -> int | None:
        """The number in ``submap/k``, ``None`` for ``map``; raises ``UnknownName``."""
        number = submap_of(frame)
        if number is not None:
            self.state.submap(number)
        return number

    # -- poses -------------------------------------------------------------------------------

    def pose(self, robot: str, frame: str = "map") -> PoseEstimate:
        """Where a robot is, in ``map``, ``odom`` or ``submap/k``.

        Raises ``UnknownName`` and ``NotConnected`` where no path of ties leads to the frame, or, for
        ``odom``, there is no motion model.
        """
        r, space = self.state.robot(robot), self.space
        if frame == "odom":
            if r.odom is None:
                raise NotConnected(f"robot {robot!r} has no 'odom': there is no dead reckoning without a motion model")
            return PoseEstimate(frame, r.t, r.odom, r.odom_covariance, "dead_reckoning", r.submap)
        target = self._submap_of(frame)
        active = self.state.submap(r.submap)
        if target is None:
            self._in_map(active)
            placed = self.placed(r.submap)
            correction = None if r.odom is None else space.compose(placed.end, space.inverse(r.odom))
            return PoseEstimate(frame, r.t, placed.end, placed.end_covariance, "joined", r.submap, correction)
        local = additive_covariance(active, [], with_pose=True)
        if target == r.submap:
            return PoseEstimate(frame, r.t, r.pose, local, "filtered", r.submap)
        T, covariance, _ = self.transform(target, r.submap)
        there, by_both = space.compose(T, r.pose), space.compose_covariance(T, covariance, r.pose, local)
        return PoseEstimate(frame, r.t, there, by_both, "path", r.submap)

    # -- landmarks ---------------------------------------------------------------------------

    def landmark_ids(self) -> Sequence[str]:
        """Names of the landmarks in order of first sighting."""
        return [name for name in self.state.names[: self.state.landmark_count] if as_encounter(name) is None]

    def landmark(self, name: str, frame: str = "map") -> LandmarkEstimate:
        """A landmark in ``map`` or ``submap/k``; raises ``UnknownName`` and ``NotConnected``."""
        number = self.state.number_of.get(name, self.state.landmark_count)
        seen = number < self.state.landmark_count and self.state.submaps_with(number)
        if not seen or as_encounter(name) is not None:
            raise UnknownName(f"landmark {name!r} has not been seen in this map")
        return self._landmark(number, frame)

    def _landmark(self, number: int, frame: str) -> LandmarkEstimate:
        holders = self.state.submaps_with(number)
        target = self._submap_of(frame)
        if target is None:
            own = [k for k in holders if self.connected(self.state.submap(k).robot)]
            if not own:
                self._in_map(self.state.submap(holders[0]))
            point, covariance = self._joined(number, [k for k in own if not self._is_untied(k, number)] or own)
        else:
            point, covariance = self._by_path(number, holders, target)
        return LandmarkEstimate(self.state.names[number], point, covariance, tuple(holders))

    def _is_untied(self, submap: int, landmark: int) -> bool:
        solution = self.state.solution
        return solution is not None and (submap, landmark) in solution.untied

    def untied(self, submap: int) -> list[str]:
        """Names of a sub-map's landmarks whose first sighting there does not agree with the map."""
        untied = () if self.state.solution is None else self.state.solution.untied
        return [self.state.names[i] for k, i in sorted(untied) if k == submap]

    def _joined(self, number: int, holders: list[int]) -> tuple[Floats, Floats]:
        """From the newest sub-map that the solution reaches through it, else from the solution."""
        solution = self.state.solution
        newest = self.placed(holders[-1])
        if solution is None or number in newest.shared:
            return newest.landmark(number)
        base = [k for k in holders if k < solution.base.submap_count and solution.base.submap(k).holds(number)]
        if not base:
            return newest.landmark(number)
        return solution.point(0, number) or solution.placed(base[0]).landmark(number)

    def _by_path(self, number: int, holders: list[int], target: int) -> tuple[Floats, Floats]:
        root = self.state.roots[self.state.submap(target).robot]
        near = [h for h in holders if self.state.roots[self.state.submap(h).robot] == root] or holders
        k = target if target in holders else min(near, key=lambda h: abs(h - target))
        submap = self.state.submap(k)
        slot = submap.slot_of(number)
        point, covariance = submap.mean[slot : slot + self.space.dim], additive_covariance(submap, [slot])
        if k == target:
            return point, covariance
        T, by_frame, _ = self.transform(target, k)
        return transformed(self.space, T, by_frame, point, covariance)

    def landmarks(
        self, start: int = 0, limit: int = 100, frame: str = "map", bbox: Box | None = None
    ) -> tuple[list[LandmarkEstimate], int | None]:
        """Up to ``limit`` landmarks from number ``start`` on, in order of first sighting, and where to go on.

        ``bbox`` (x0, y0, x1, y1) keeps those inside, at any height. In ``map``, landmarks that no tie connects to it
        are left out.
        """
        found: list[LandmarkEstimate] = []
        for number in range(start, self.state.landmark_count):
            if len(found) == limit:
                return found, number
            if as_encounter(self.state.names[number]) is not None or not self.state.submaps_with(number):
                continue
            try:
                estimate = self._landmark(number, frame)
            except NotConnected:
                continue
            if bbox is None or (bbox[0] <= estimate.x <= bbox[2] and bbox[1] <= estimate.y <= bbox[3]):
                found.append(estimate)
        return found, None

    def not_connected(self, frame: str = "map") -> int:
        """How many landmarks have no place in ``map``, or by paths of ties in ``submap/k``."""
        target = self._submap_of(frame)
        root = 0 if target is None else self.state.roots[self.state.submap(target).robot]
        if set(self.state.roots) <= {root}:
            return 0
        if root not in self._outside:
            inside = np.zeros(self.state.landmark_count, dtype=bool)
            for submap in self.state.submaps():
                if self.state.roots[submap.robot] == root:
                    inside[submap.landmarks] = True
            missing = np.flatnonzero(~inside).tolist()
            names = (self.state.names[i] for i in missing)
            self._outside[root] = sum(as_encounter(name) is None for name in names)
        return self._outside[root]

    # -- sub-maps and the graph --------------------------------------------------------------

    def submap(self, number: int) -> SubmapState:
        """What the atlas says of a sub-map; raises ``UnknownName``."""
        s = self.state.submap(number)
        robot = self.state.fleet[s.robot]
        placed = self.placed(number) if self.connected(s.robot) else None
        return SubmapState(
            id=number, robot=robot.id, active=s.active,
            pose=placed.frame if placed else None, covariance=placed.frame_covariance if placed else None,
            landmarks=int(s.landmarks.shape[0]), steps=s.steps, observations=s.observations,
            nis=s.nis_sum / (robot.channels * s.nis_count) if s.nis_count else None,
            began=s.began, ended=None if s.active else s.ended,
        )  # fmt: skip

    def submaps(self) -> Iterator[SubmapState]:
        """Every sub-map, by number."""
        return (self.submap(k) for k in range(self.submap_count))

    def local_pose(self, number: int) -> tuple[Pose, Floats]:
        """The pose at a sub-map's end in its own frame, with its (pose, pose) covariance."""
        s = self.state.submap(number)
        return s.pose, additive_covariance(s, [], with_pose=True)

    def local_landmarks(self, number: int) -> list[LandmarkEstimate]:
        """A sub-map's landmarks in its own frame."""
        s = self.state.submap(number)
        found = []
        for i, slot in s.slots().items():
            if as_encounter(self.state.names[i]) is not None:
                continue
            covariance = additive_covariance(s, [slot])
            position, holders = s.mean[slot : slot + self.space.dim], tuple(self.state.submaps_with(i))
            found.append(LandmarkEstimate(self.state.names[i], position, covariance, holders))
        return found

    def edges(self, start: int = 0, limit: int | None = None) -> list[Edge]:
        """Edges of the graph from number ``start`` on, in an order that never changes."""
        pairs = self.graph.pairs()
        return [self.graph.edge(*pair) for pair in pairs[start : None if limit is None else start + limit]]

    def transform(self, source: int, target: int) -> tuple[Pose, Floats, list[int]]:
        """T_source_target, its (pose, pose) covariance, and the path of sub-maps that it composes along."""
        if source == target:
            self.state.submap(source)
            return self.space.origin, np.zeros((self.space.pose, self.space.pose)), [source]
        return self.graph.path(source, target)
