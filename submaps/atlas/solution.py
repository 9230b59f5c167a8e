"""A solve's result: where the sub-maps' frames and shared landmarks lie, and how surely."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from submaps.atlas.cholesky import information
from submaps.atlas.component import Component, Link, Part
from submaps.atlas.front import Front, advance
from submaps.atlas.placed import Placed
from submaps.atlas.sparse import Factorisation, InverseSubset
from submaps.atlas.state import AtlasState, submap_of
from submaps.config import Start
from submaps.errors import MeasurementError
from submaps.submap import Submap

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Untied = frozenset[tuple[int, int]]
_NONE = np.empty(0, dtype=np.int32)


class Components:
    """Makes the components of a state: each from its robots, the others' landmarks in view.

    ``untied`` are the pairs (sub-map, landmark) that did not agree with the map.
    """

    def __init__(self, state: AtlasState, untied: Iterable[tuple[int, int]], known: Mapping[int, Part]) -> None:
        self.state = state
        self.untied: Untied = frozenset(untied)
        self.known = dict(known)
        every = [s.landmarks for s in state.submaps()]
        self._total = np.bincount(np.concatenate([*every, _NONE]), minlength=state.landmark_count)

    def of(self, robots: Iterable[int]) -> Component:
        """The component of some robots."""
        numbers = set(robots)
        starts = [(r.start, self.state.submap(r.first)) for r in self.state.fleet if r.number in numbers]
        links = [_link(start, first) for start, first in starts if start is not None]
        made = Component(self.state.members(numbers), self._total, self.untied, links, self.known)
        self.known |= made.known_parts()
        return made

    def without(self, untied: Iterable[tuple[int, int]]) -> Components:
        """The same with other pairs untied."""
        return Components(self.state, untied, self.known)


def by_root(roots: Iterable[int]) -> dict[int, list[int]]:
    """The robots of each component, by its root."""
    groups: dict[int, list[int]] = {}
    for robot, root in enumerate(roots):
        groups.setdefault(root, []).append(robot)
    return groups


def _link(start: Start, first: Submap) -> Link:
    """A start as a factor: its covariance carried to the filter's error, d(p) = xi_p + turn(p) xi_theta."""
    space = first.space
    carry = np.eye(space.pose)
    if first.invariant:
        carry[: space.dim, space.dim :] = -space.turn(np.array(start.pose[: space.dim]))
    covariance = np.ascontiguousarray(carry @ np.array(start.covariance) @ carry.T)
    out = np.empty_like(covariance)
    if not information(covariance, out):
        raise MeasurementError(f"the start of submap {first.number}: its covariance is not positive definite")
    return Link(submap_of(start.frame), first.number, start.pose, out, first.invariant)


class Solution:
    """Values of a solve over the state that it was computed from.

    ``frames`` (submaps, pose) and ``ends`` (robots, pose) are poses (see ``geometry.space``) in the frame
    of their component, ``landmarks`` (m, dim) the shared landmarks, component after component. ``roots``
    (robots,) names for each robot the lowest robot of its component, ``untied`` (k, 2) the pairs
    (sub-map, landmark) that do not agree with the map. Covariances are derived when first asked
    for, from these values alone: a replayed solution gives the same bits.
    """

    def __init__(
        self, base: AtlasState, frames: Floats, ends: Floats, landmarks: Floats, iterations: int, cost: float,
        roots: list[int], untied: Untied, components: dict[int, Component] | None = None,
    ) -> None:  # fmt: skip
        self.base = base
        self.frames = frames
        self.ends = ends
        self.landmarks = landmarks
        self.iterations = iterations
        self.cost = cost
        self.roots = roots
        self.untied = untied
        self.settled: dict[str, Any] = {}  # what views have derived from it and from closed sub-maps
        self._lock = threading.RLock()
        self._components = components or {}
        self._inverses: dict[int, InverseSubset] = {}
        self._placed: dict[int, Placed] = {}

    def columns(self) -> dict[str, NDArray[np.generic]]:
        """What a journal keeps of a solve: its values, iterations and cost."""
        return {
            "frames": self.frames,
            "ends": self.ends,
            "landmarks": self.landmarks,
            "iterations_cost": np.array([float(self.iterations), self.cost]),
            "roots": np.array(self.roots, dtype=np.int64),
            "untied": np.array(sorted(self.untied), dtype=np.int64).reshape(-1, 2),
        }

    def starting_point(self) -> list[NDArray[np.generic]]:
        """What the next solve takes from this one."""
        alone = self.roots == list(range(len(self.roots)))
        more = [] if alone and not self.untied else [self.columns()["roots"], self.columns()["untied"]]
        return [self.frames, self.landmarks, *more]

    @classmethod
    def from_columns(cls, state: AtlasState, columns: Mapping[str, NDArray[np.generic]]) -> Solution:
        """The solution that ``columns`` of a solve of ``state`` describes, without solving again."""
        frames, ends = _floats(columns["frames"]), _floats(columns["ends"])
        if frames.shape[0] != state.submap_count or ends.shape[0] != len(state.robots):
            raise MeasurementError(
                f"a solve of {frames.shape[0]} sub-maps and {ends.shape[0]} robots does not fit a state of "
                f"{state.submap_count} and {len(state.robots)}"
            )
        iterations, cost = _floats(columns["iterations_cost"])
        # Solves journaled before robots could meet have neither.
        roots = columns.get("roots", np.arange(ends.shape[0])).tolist()
        untied = frozenset((k, i) for k, i in columns.get("untied", np.empty((0, 2), dtype=np.int64)).tolist())
        landmarks = _floats(columns["landmarks"])
        return cls(replace(state, solution=None), frames, ends, landmarks, int(iterations), float(cost), roots, untied)

    def root(self, number: int) -> int:
        """The root of the component that sub-map ``number`` of the base state is in."""
        return self.roots[self.base.submap(number).robot]

    def component(self, root: int) -> Component:
        """A component by its root, with this solution's values in it."""
        with self._lock:
            if root not in self._components:
                self._rebuild()
            return self._components[root]

    def known_parts(self) -> dict[int, Part]:
        """Parts of every component, for the next solve."""
        parts: dict[int, Part] = {}
        for root in set(self.roots):
            parts |= self.component(root).known_parts()
        return parts

    def _rebuild(self) -> None:
        components = Components(self.base, self.untied, {})
        at = 0
        for root, robots in sorted(by_root(self.roots).items()):
            made = components.of(robots)
            made.frames[made.frame_at] = self.frames[made.numbers]
            for f, submap in enumerate(made.members):
                if submap.active:
                    made.frames[made.end_at[f]] = self.ends[submap.robot]
            made.points[:] = self.landmarks[at : at + len(made.landmarks)]
            at += len(made.landmarks)
            self._components[root] = made

    def placed(self, number: int) -> Placed:
        """Sub-map ``number`` of the base state, with the joint covariance of its global variables."""
        with self._lock:
            if number not in self._placed:
                root = self.root(number)
                self._placed[number] = self.component(root).placed(number, self.inverse(root))
            return self._placed[number]

    def prepare(self) -> None:
        """Derive now what the next queries would wait for: covariances, and the robots' places."""
        for root in sorted(set(self.roots)):
            self.inverse(root)
        for number in self.base.active:
            self.placed(number)
        self._catch_up()

    def front(self, submap: Submap) -> Front:
        """What it leaves to a sub-map of the base state that was active then (see ``atlas.front``)."""
        fixed = submap.previous < 0 and self.root(submap.number) == submap.robot
        return Front.of_solution(self.placed(submap.number), fixed and self.base.fleet[submap.robot].start is None)

    def _catch_up(self) -> None:
        """Bring the fronts forward through what has closed meanwhile: the records only grow."""
        fronts, records = self.settled.setdefault("fronts", {}), self.base.records
        for number, submap in self.base.active.items():
            front, closed = self.front(submap), records[number]
            while closed is not None and (following := records[closed.following]) is not None:
                front = advance(front, closed, following)
                fronts[following.number] = front
                closed = following

    def inverse(self, root: int) -> InverseSubset:
        """Joint covariances of a component's variables, where they share a factor."""
        with self._lock:
            if root not in self._inverses:
                self._inverses[root] = factorised(self.component(root)).inverse_subset()
            return self._inverses[root]

    def point(self, root: int, landmark: int) -> tuple[Floats, Floats] | None:
        """A shared landmark's position (dim,) and covariance (dim, dim), or ``None`` where it is not shared."""
        component = self.component(root)
        variable = component.variable_of(landmark)
        if variable is None:
            return None
        covariance = self.inverse(root).joint(np.array([variable]))
        return component.points[variable - component.poses], covariance


def factorised(component: Component) -> Factorisation:
    """The factorised normal equations of a whole component at its present values."""
    data = np.empty(component.pattern.indices.shape[0])
    component.assemble(len(component.members), data, np.empty(component.pattern.size))
    return Factorisation(component.pattern, data)


def _floats(column: NDArray[np.generic]) -> Floats:
    return np.asarray(column, dtype=np.float64)
