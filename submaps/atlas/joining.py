"""Joining: the sub-maps' frames and shared landmarks that fit all sub-maps best, grown in order.

Started from the odometry chain, Gauss-Newton falls into wrong minima. So the solution is grown: each
sub-map is placed by the solution so far, and the whole is settled after every few sub-maps that tie
to others than their neighbour. What the last solve has placed is where the next begins.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from submaps.atlas.component import Component
from submaps.atlas.solution import Solution
from submaps.atlas.sparse import Factorisation
from submaps.atlas.state import AtlasState
from submaps.errors import NumericalError

Floats = NDArray[np.float64]

# Sub-maps with ties to older ones that may be placed before the whole is settled again: a few, and
# more where they are a small part of the whole.
_TIES_BEFORE_SETTLING = 8
_SETTLED_M = 1e-3
_CONVERGED_M = 1e-7
_SETTLING_ITERATIONS = 3
_MOST_ITERATIONS = 60


@dataclass
class _Solver:
    """Normal equations of one component, and how often they were solved."""

    component: Component
    data: Floats
    gradient: Floats
    factorisation: Factorisation | None = None
    iterations: int = 0
    cost: float = 0.0

    def settle(self, factors: int, most: int, tolerance: float) -> None:
        """Gauss-Newton on the first ``factors`` factors; a step that raises the cost is halved."""
        c = self.component
        cost = c.assemble(factors, self.data, self.gradient)
        for _ in range(most):
            if self.factorisation is None:
                self.factorisation = Factorisation(c.pattern, self.data)
            else:
                self.factorisation.update(self.data)
            step = -self.factorisation.solve(self.gradient)
            before = cost
            c.move(step)
            cost = c.assemble(factors, self.data, self.gradient)
            while not cost <= before * (1.0 + 1e-9) + 1e-9 and float(np.abs(step).max(initial=0.0)) > tolerance:
                c.move(-0.5 * step)
                step *= 0.5
                cost = c.assemble(factors, self.data, self.gradient)
            self.iterations += 1
            if not math.isfinite(cost):
                raise NumericalError("the joined problem left the finite numbers")
            if float(np.abs(step).max(initial=0.0)) < tolerance:
                break
        self.cost = cost


def join(state: AtlasState) -> Solution:
    """The joined solution of an atlas: argmin over frames and landmarks of sum xi_k^T P_k^-1 xi_k.

    Each robot's chain is a component of its own, in the frame of its first sub-map. Raises
    ``NumericalError`` where a pivot is not positive.
    """
    frames = np.full((state.submap_count, 3), np.nan)
    ends = np.full((len(state.robots), 3), np.nan)
    components: dict[int, Component] = {}
    iterations, cost = 0, 0.0
    for robot in sorted(state.robots.values(), key=lambda r: r.number):
        last = state.solution
        before = last.component(robot.number) if last is not None and robot.number < len(last.base.robots) else None
        component = Component(state.chain(robot.number), before)
        known = _start(component, state.solution)
        solver = _grow(component, known)
        iterations += solver.iterations
        cost += solver.cost
        frames[[s.number for s in component.chain]] = component.frames[:-1]
        ends[robot.number] = component.frames[-1]
        components[robot.number] = component
    landmarks = np.concatenate([*(c.points for c in components.values()), np.empty((0, 2))])
    return Solution(replace(state, solution=None), frames, ends, landmarks, iterations, cost, components)


def _start(component: Component, solution: Solution | None) -> int:
    """Take over what the last solve placed; returns how many factors' frames and ends it covers."""
    component.frames[1:] = np.nan
    if solution is None:
        return 0
    numbers = [s.number for s in component.chain]
    known = sum(number < solution.base.submap_count for number in numbers)
    component.frames[:known] = solution.frames[numbers[:known]]
    if known:
        previous = solution.component(component.chain[0].robot)
        for number, i in component.variable_of.items():
            at = previous.variable_of.get(number)
            if at is not None:
                component.points[i - len(numbers)] = previous.points[at - len(previous.chain)]
    return max(known - 1, 0)


def _grow(component: Component, known: int) -> _Solver:
    size = component.pattern.indices.shape[0]
    solver = _Solver(component, np.empty(size), np.empty(component.pattern.size))
    last = len(component.chain) - 1
    holder: dict[int, int] = {}
    waiting = 0
    for f in range(last + 1):
        component.place(f)
        waiting += any(holder.get(i, f - 1) != f - 1 for i in component.shared[f])
        holder.update(dict.fromkeys(component.shared[f], f))
        if f < known:
            waiting = 0
        elif f < last and waiting >= max(_TIES_BEFORE_SETTLING, f // 16):
            solver.settle(f + 1, _SETTLING_ITERATIONS, _SETTLED_M)
            waiting = 0
    solver.settle(last + 1, _MOST_ITERATIONS, _CONVERGED_M)
    return solver
