"""Joining: the sub-maps' frames and shared landmarks that fit all sub-maps best, grown in order.

Started from the odometry chain, Gauss-Newton falls into wrong minima. So the solution is grown: each
sub-map is placed by the solution so far, and the whole is settled after every few sub-maps that tie
to others than their neighbour. What the last solve has placed is where the next begins. Components
that have come to share landmarks are aligned and become one (see ``atlas.meeting``); with a gate,
ties that do not agree with the rest are taken back (see ``atlas.ties``).
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from submaps.atlas import meeting, ties
from submaps.atlas.component import Component
from submaps.atlas.solution import Components, Solution, by_root
from submaps.atlas.sparse import Factorisation
from submaps.atlas.state import AtlasState
from submaps.consistency import chi_square_bound
from submaps.errors import NumericalError

Floats = NDArray[np.float64]

# Sub-maps with ties to older ones that may be placed before the whole is settled again: a few, and
# more where they are a small part of the whole.
_TIES_BEFORE_SETTLING = 8
_SETTLED_M = 1e-3
_CONVERGED_M = 1e-7
_SETTLING_ITERATIONS = 3
_MOST_ITERATIONS = 60
# Rounds of taking ties back; each takes all that stand out most.
_TIE_ROUNDS = 20


@dataclass
class _Solver:
    """Normal equations of one component, and how often they were solved."""

    component: Component
    data: Floats
    gradient: Floats
    factorisation: Factorisation | None = None
    iterations: int = 0
    cost: float = 0.0

    @classmethod
    def of(cls, component: Component) -> _Solver:
        """One that has not solved yet."""
        return cls(component, np.empty(component.pattern.indices.shape[0]), np.empty(component.pattern.size))

    def converge(self, tolerance: float) -> None:
        """Settle the whole until a step is below the tolerance."""
        self.settle(len(self.component.members), _MOST_ITERATIONS, tolerance)

    def settle(self, members: int, most: int, tolerance: float) -> None:
        """Gauss-Newton on the first ``members``; a step that raises the cost is halved."""
        c = self.component
        cost = c.assemble(members, self.data, self.gradient)
        for _ in range(most):
            if self.factorisation is None:
                self.factorisation = Factorisation(c.pattern, self.data)
            else:
                self.factorisation.update(self.data)
            step = -self.factorisation.solve(self.gradient)
            before = cost
            c.move(step)
            cost = c.assemble(members, self.data, self.gradient)
            while not cost <= before * (1.0 + 1e-9) + 1e-9 and float(np.abs(step).max(initial=0.0)) > tolerance:
                c.move(-0.5 * step)
                step *= 0.5
                cost = c.assemble(members, self.data, self.gradient)
            self.iterations += 1
            if not math.isfinite(cost):
                raise NumericalError("the joined problem left the finite numbers")
            if float(np.abs(step).max(initial=0.0)) < tolerance:
                break
        self.cost = cost


def join(state: AtlasState) -> Solution:
    """The joined solution of an atlas: argmin over frames and landmarks of sum xi_k^T P_k^-1 xi_k.

    A component is solved in the frame of its first robot's first sub-map (or, where that robot has a
    start, in the frame of the start). Raises ``NumericalError`` where a pivot is not positive.
    """
    last = state.solution
    known = {} if last is None else last.known_parts()
    components = Components(state, () if last is None else last.untied, known)
    solvers = {root: _grow(components.of(robots), last) for root, robots in by_root(state.roots).items()}
    iterations = sum(s.iterations for s in solvers.values())
    roots = list(state.roots)
    while (meet := _meet(components, solvers, roots)) is not None:
        components, roots, used = meet
        iterations += used
    if state.config.gate is not None:
        components, used = _check_ties(components, solvers, roots)
        iterations += used
    for solver in solvers.values():
        before = solver.iterations
        solver.converge(_CONVERGED_M)
        iterations += solver.iterations - before
    return _collect(components, solvers, roots, iterations)


def _collect(components: Components, solvers: dict[int, _Solver], roots: list[int], iterations: int) -> Solution:
    state = components.state
    space = state.space
    frames = np.full((state.submap_count, space.pose), np.nan)
    ends = np.full((len(state.robots), space.pose), np.nan)
    parts = {root: solver.component for root, solver in sorted(solvers.items())}
    for part in parts.values():
        frames[part.numbers] = part.frames[part.frame_at]
        for f, submap in enumerate(part.members):
            if submap.active:
                ends[submap.robot] = part.frames[part.end_at[f]]
    landmarks = np.concatenate([*(c.points for c in parts.values()), np.empty((0, space.dim))])
    cost = sum(solver.cost for solver in solvers.values())
    base = replace(state, solution=None)
    return Solution(base, frames, ends, landmarks, iterations, cost, roots, components.untied, parts)


def _grow(component: Component, last: Solution | None) -> _Solver:
    """Take over what the last solve placed, and grow the rest in order of the sub-maps' numbers."""
    known = _start(component, last)
    for f in component.unplaced():
        if f < known:
            component.place(f)
    holder = component.last_holders(known)
    solver = _Solver.of(component)
    end, waiting = len(component.members), 0
    for f in range(known, end):
        component.place(f)
        rows = component.point_rows(f)
        before = component.at(component.members[f].previous)
        waiting += bool(np.any((holder[rows] >= 0) & (holder[rows] != before)))
        holder[rows] = f
        if f < end - 1 and waiting >= max(_TIES_BEFORE_SETTLING, f // 16):
            solver.settle(f + 1, _SETTLING_ITERATIONS, _SETTLED_M)
            waiting = 0
    solver.converge(_SETTLED_M)
    return solver


def _start(component: Component, last: Solution | None) -> int:
    """Take over what the last solve placed; returns how many members it has placed for good."""
    component.frames[1:] = np.nan
    if last is None:
        return 0
    placed = int(np.searchsorted(component.numbers, last.base.submap_count))
    component.frames[component.frame_at[:placed]] = last.frames[component.numbers[:placed]]
    if placed:  # the component was one before, if a smaller one
        component.take_points(last.component(last.root(int(component.numbers[0]))), component.space.origin)
    return sum(not last.base.submap(int(number)).active for number in component.numbers[:placed])


def _met(solvers: dict[int, _Solver], least: int) -> list[tuple[int, int]]:
    """Pairs of roots whose components hold at least so many landmarks in common."""
    roots_of: dict[int, list[int]] = {}
    for root in sorted(solvers):
        for landmark in solvers[root].component.landmarks:
            roots_of.setdefault(landmark, []).append(root)
    common = Counter(pair for roots in roots_of.values() for pair in combinations(roots, 2))
    return sorted(pair for pair, count in common.items() if count >= least)


def _meet(
    components: Components, solvers: dict[int, _Solver], roots: list[int]
) -> tuple[Components, list[int], int] | None:
    """Make one of the first two components that have met; ``None`` where none have."""
    for a, b in _met(solvers, components.state.space.dim):
        mine, theirs = solvers[a], solvers[b]
        met = meeting.meet(mine.component, theirs.component, components.state.config.gate)
        if met is None:
            continue
        merged = components.without(components.untied | met.untied)
        joint = merged.of(r for r, root in enumerate(roots) if root in (a, b))
        joint.take(mine.component, joint.space.origin)
        joint.take(theirs.component, met.transform)
        solver = _Solver.of(joint)
        solver.converge(_SETTLED_M)
        if solver.cost - mine.cost - theirs.cost <= met.most_cost:
            solvers[a] = solver
            del solvers[b]
            return merged, [a if root == b else root for root in roots], solver.iterations
    return None


def _check_ties(components: Components, solvers: dict[int, _Solver], roots: list[int]) -> tuple[Components, int]:
    """Take ties back, or give them, until all that are new agree with the map."""
    bound = chi_square_bound(components.state.config.gate or 1.0, components.state.space.dim)
    iterations, before = 0, components.untied
    for root, robots in by_root(roots).items():
        second_chance = True
        for _ in range(_TIE_ROUNDS):
            component = solvers[root].component
            untied = ties.checked(component, _news(component, components.state, robots), components.untied, bound)
            if untied == components.untied and second_chance:
                second_chance = False
                untied = ties.readmitted(component, untied - before, untied, bound)
            if untied == components.untied:
                break
            components = components.without(untied)
            again = components.of(robots)
            again.take(component, again.space.origin)
            solvers[root] = _Solver.of(again)
            solvers[root].converge(_SETTLED_M)
            iterations += solvers[root].iterations
    return components, iterations


def _news(component: Component, state: AtlasState, robots: list[int]) -> list[int]:
    """Members that the last solve did not have as they are, or not in this component."""
    last = state.solution
    if last is None or by_root(last.roots).get(robots[0]) != robots:
        return list(range(len(component.members)))
    count = last.base.submap_count
    return [f for f, s in enumerate(component.members) if s.number >= count or last.base.submap(s.number) is not s]
