"""The graph of relative transforms between sub-maps, and the surest path through it.

An ``exit`` edge is a sub-map's end pose, where the next began. A ``tie`` joins two sub-maps of one
component that hold two or more landmarks in common, in space three, by weighted least squares. A
``start`` is where a robot's first sub-map lies as its operator said. The transform between any two sub-maps
composes along the path that a uniform-cost search finds, its cost the determinant of the composed
covariance (Bosse, Newman, Leonard, Teller, IJRR 23(12), 2004).
"""

from __future__ import annotations

import heapq
import itertools
from collections import Counter
from dataclasses import dataclass
from itertools import chain
from typing import Literal

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from submaps.atlas.placed import additive_covariance
from submaps.atlas.state import AtlasState, submap_of
from submaps.atlas.tie import fit
from submaps.config import Start
from submaps.errors import NotConnected
from submaps.geometry.space import Pose, Space
from submaps.submap import Submap

Floats = NDArray[np.float64]
Kind = Literal["exit", "tie", "start"]
Pair = tuple[Kind, int, int]
# Lets a path of edges without variance still cost something for each edge: (1e-4 m)² and (1e-5 rad)² an axis.
_FLOOR_POSITION, _FLOOR_ROTATION = 1e-8, 1e-10
# In space a rotation about some axis that is less sure than this (rad) is taken to be unknown: three landmarks
# all but on a line, whose scatter about it looks like a lever. In the plane two at one place leave no lever at all.
_SURE_ROTATION = 1.0 / 3.0


@dataclass(frozen=True)
class Edge:
    """T_a_b of two sub-maps and the (pose, pose) covariance of its additive errors (see ``geometry.space``)."""

    kind: Kind
    a: int
    b: int
    transform: Pose
    covariance: Floats


def origin_of(state: AtlasState, start: Start) -> int:
    """The sub-map in whose frame a start is given; ``map`` is the first one's."""
    return submap_of(start.frame) or 0


def _turning_freely(space: Space, a: Floats, b: Floats, C: Floats) -> tuple[Floats, Floats]:
    """T_a_b of sub-maps whose common landmarks all lie at one place, or on a line: any rotation, variance pi^2/3.

    A robot that stands still while another sees it twice is such a place.
    """
    dim, free = space.dim, np.pi**2 / 3.0
    covariance = np.zeros((space.pose, space.pose))
    covariance[dim:, dim:] = free * np.eye(space.rot)
    covariance[:dim, :dim] = C + float(b @ b) * free * np.eye(dim)
    return np.concatenate([a - b, np.zeros(space.rot)]), covariance


def _is_sure(space: Space, covariance: Floats) -> bool:
    """Whether landmarks determine a rotation about every axis."""
    turned = covariance[space.dim :, space.dim :]
    return space.dim == 2 or float(np.linalg.eigvalsh(turned)[-1]) < _SURE_ROTATION**2


class Graph:
    """The graph of one state; edges are computed when asked for, those of closed sub-maps once."""

    def __init__(self, state: AtlasState) -> None:
        self._state = state
        self._first_active = min(state.active, default=state.submap_count)
        self._pairs: list[Pair] | None = None
        self._near: dict[int, list[Pair]] = {}
        self._own: dict[Pair, Edge] = {}
        self._settled: dict[Pair, Edge] = state.settled.setdefault("edges", {})
        self._untied = frozenset() if state.solution is None else state.solution.untied
        self._starts = {r.first: origin_of(state, r.start) for r in state.fleet if r.start is not None}

    def edge_count(self) -> int:
        """How many edges there are; those of closed sub-maps are counted once."""
        degrees: dict[int, int] = self._state.settled.setdefault("degrees", {})
        total = 0
        for k in range(self._state.submap_count):
            degree = degrees.get(k)
            if degree is None:
                degree = len(self._older(k))
                if k < self._first_active:
                    degrees[k] = degree
            total += degree
        return total

    def pairs(self) -> list[Pair]:
        """(kind, a, b) of every edge, by the younger of its two sub-maps."""
        if self._pairs is None:
            self._pairs = list(chain.from_iterable(self._older(k) for k in range(self._state.submap_count)))
        return self._pairs

    def _older(self, number: int) -> list[Pair]:
        """Edges from a sub-map to older ones: its exit edge, its start, then its ties."""
        submap = self._state.submap(number)
        found: list[Pair] = [("exit", submap.previous, number)] if submap.previous >= 0 else []
        if self._starts.get(number, number) != number:
            found.append(("start", self._starts[number], number))
        return found + [("tie", k, number) for k in self._tied(number) if k < number]

    def _tied(self, number: int) -> list[int]:
        """Sub-maps of the same component that hold landmarks enough in common with this one."""
        state = self._state
        submap = state.submap(number)
        held = [i for i in submap.landmarks.tolist() if (number, i) not in self._untied]
        common = Counter(chain.from_iterable(map(state.submaps_with, held)))
        common.subtract(k for k, i in self._untied if i in held)
        root = state.roots[submap.robot]
        several = (k for k, n in common.items() if n >= state.space.dim and k != number)
        return sorted(k for k in several if state.roots[state.submap(k).robot] == root)

    def neighbours(self, number: int) -> list[Pair]:
        """Every edge of a sub-map."""
        if number not in self._near:
            submap = self._state.submap(number)
            found: list[Pair] = [("tie", min(k, number), max(k, number)) for k in self._tied(number)]
            if submap.previous >= 0:
                found.append(("exit", submap.previous, number))
            if not submap.active:
                found.append(("exit", number, submap.following))
            found += [("start", a, b) for b, a in self._starts.items() if a != b and number in (a, b)]
            self._near[number] = found
        return self._near[number]

    def edge(self, kind: Kind, a: int, b: int) -> Edge:
        """The edge's transform and covariance."""
        key = (kind, a, b)
        first, second = self._state.submap(a), self._state.submap(b)
        known = self._own if first.active or second.active else self._settled
        if key not in known:
            if kind == "tie":
                known[key] = self._tie(first, second)
            elif kind == "start":
                known[key] = self._start(first, second)
            else:
                known[key] = Edge(kind, a, b, first.pose, additive_covariance(first, [], with_pose=True))
        return known[key]

    def _tie(self, first: Submap, second: Submap) -> Edge:
        """The tie of two sub-maps with common landmarks (see ``atlas.tie``)."""
        in_first, in_second = first.slots(), second.slots()
        untied = self._untied
        common = [i for i in in_first if i in in_second and not {(first.number, i), (second.number, i)} & untied]
        slots_a, slots_b = [in_first[i] for i in common], [in_second[i] for i in common]
        space = first.space
        dim, pose = space.dim, space.pose
        A = np.array([first.mean[k : k + dim] for k in slots_a])
        B = np.array([second.mean[k : k + dim] for k in slots_b])
        T, covariance = np.empty(pose), np.empty((pose, pose))
        cov_a, cov_b = additive_covariance(first, slots_a), additive_covariance(second, slots_b)
        if not (fit(space.key, A, B, cov_a, cov_b, T, covariance) and _is_sure(space, covariance)):
            T, covariance = _turning_freely(space, A[0], B[0], cov_a[:dim, :dim] + cov_b[:dim, :dim])
        return Edge("tie", first.number, second.number, space.as_pose(T), covariance)

    def _start(self, first: Submap, second: Submap) -> Edge:
        start, base = self._state.fleet[second.robot].start, self._state.fleet[0].start
        assert start is not None
        space = first.space
        T, covariance = start.pose, np.array(start.covariance)
        if base is not None and start.frame == "map":  # the first sub-map is not where `map` is
            back, own = space.inverse(base.pose), space.inverse_covariance(base.pose, np.array(base.covariance))
            T, covariance = space.compose(back, T), space.compose_covariance(back, own, T, covariance)
        return Edge("start", first.number, second.number, T, covariance)

    def path(self, source: int, target: int) -> tuple[Pose, Floats, list[int]]:
        """T_source_target along the surest path, its covariance, and the path.

        Raises ``UnknownName`` for a sub-map that is not there, ``NotConnected`` without a path.
        """
        self._state.submap(source)
        self._state.submap(target)
        order, space = itertools.count(), self._state.space
        floor = np.diag([_FLOOR_POSITION] * space.dim + [_FLOOR_ROTATION] * space.rot)
        queue: list[tuple[float, int, int, Pose, Floats, list[int]]] = [
            (0.0, next(order), source, space.origin, np.zeros_like(floor), [source])
        ]
        done: set[int] = set()
        while queue:
            _, _, at, T, covariance, path = heapq.heappop(queue)
            if at == target:
                return T, covariance, path
            if at in done:
                continue
            done.add(at)
            for kind, a, b in self.neighbours(at):
                other = b if a == at else a
                if other in done:
                    continue
                edge = self.edge(kind, a, b)
                step, own = edge.transform, edge.covariance
                if a != at:
                    step, own = space.inverse(step), space.inverse_covariance(step, own)
                grown = space.compose_covariance(T, covariance, step, own)
                cost = float(np.linalg.det(grown + len(path) * floor))
                heapq.heappush(queue, (cost, next(order), other, space.compose(T, step), grown, [*path, other]))
        raise NotConnected(f"no path of ties leads from submap/{source} to submap/{target}")

    def as_networkx(self) -> nx.MultiGraph[int]:
        """The graph with its edges' ``kind``, ``transform`` (T_a_b, a the smaller number) and ``covariance``."""
        graph: nx.MultiGraph[int] = nx.MultiGraph()
        graph.add_nodes_from(range(self._state.submap_count))
        for pair in self.pairs():
            e = self.edge(*pair)
            graph.add_edge(e.a, e.b, key=e.kind, kind=e.kind, transform=e.transform, covariance=e.covariance)
        return graph
