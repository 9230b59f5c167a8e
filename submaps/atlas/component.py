"""One component of the atlas as a least-squares problem: flat arrays for the compiled assembly.

Variables are numbered: the frames after the first (which is fixed), in chain order, the last of them
the robot's present pose; then the landmarks that at least two sub-maps hold.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.atlas.factors import factor, normal_equations, residual, rows_of
from submaps.atlas.placed import Placed, as_pose
from submaps.atlas.sparse import InverseSubset, Pattern, scatter
from submaps.geometry.se2 import compose, transform
from submaps.submap import Submap

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
FIXED = -1


@jit(
    "float64(int64, int64, boolean, int64[::1], int64[::1], int64[::1], int64[::1], float64[::1], float64[::1],"
    "float64[:, ::1], float64[:, ::1], int64[::1], int64[::1], int64[::1], int64[::1], int32[::1],"
    "float64[::1], float64[::1])"
)
def _assemble(
    first: int, last: int, invariant: bool, variable_at: Ints, variables: Ints, estimate_at: Ints,
    information_at: Ints, estimates: Floats, informations: Floats, frames: Floats, points: Floats,
    begins: Ints, rows: Ints, within: Ints, start: Ints, pointers: NDArray[np.int32],
    data: Floats, gradient: Floats,
) -> float:  # fmt: skip
    """Add factors ``first`` .. ``last`` - 1 at the given values to the normal equations; their cost."""
    cost = 0.0
    poses = frames.shape[0] - 1
    for f in range(first, last):
        own = variables[variable_at[f] : variable_at[f + 1]]
        estimate = estimates[estimate_at[f] : estimate_at[f + 1]]
        d = estimate.shape[0]
        information = informations[information_at[f] : information_at[f + 1]].reshape(d, d)
        seen = np.empty((own.shape[0] - 2, 2))
        for i in range(seen.shape[0]):
            seen[i, 0] = points[own[i + 2] - poses, 0]
            seen[i, 1] = points[own[i + 2] - poses, 1]
        xi = np.empty(d)
        J = np.empty((d, 8))
        residual(invariant, estimate, frames[own[0] + 1], frames[own[1] + 1], seen, xi, J)
        H = np.empty((d + 3, d + 3))
        g = np.empty(d + 3)
        cost += normal_equations(information, xi, J, H, g)
        scatter(own, H, g, begins, rows, within, start, pointers, data, gradient)
    return cost


class Component:
    """A chain of sub-maps, the last of them active, as factors over frames and shared landmarks."""

    def __init__(self, chain: list[Submap], previous: Component | None = None) -> None:
        self.chain = chain
        held = Counter(i for s in chain for i in s.slot)
        self.landmarks = sorted(i for i, times in held.items() if times > 1)
        count = len(chain)
        self.variable_of = {number: count + i for i, number in enumerate(self.landmarks)}
        self.shared = [[i for i in s.slot if held[i] > 1] for s in chain]
        own = [
            np.array([f - 1, f, *(self.variable_of[i] for i in self.shared[f])], dtype=np.int64) for f in range(count)
        ]
        self.parts = [self._part(f, previous) for f in range(count)]
        self.invariant = chain[0].invariant
        self._variables = np.concatenate(own)
        self._variable_at = _offsets([v.shape[0] for v in own])
        self._estimates = np.concatenate([e for e, _ in self.parts])
        self._estimate_at = _offsets([e.shape[0] for e, _ in self.parts])
        self._informations = np.concatenate([i.ravel() for _, i in self.parts])
        self._information_at = _offsets([i.size for _, i in self.parts])
        widths = np.array([3] * count + [2] * len(self.landmarks), dtype=np.int64)
        self.pattern = Pattern(widths, own)
        self.frames = np.zeros((count + 1, 3))
        self.points = np.full((len(self.landmarks), 2), np.nan)

    def _part(self, f: int, previous: Component | None) -> tuple[Floats, Floats]:
        """Estimate and information of factor f, taken over where the last solve had the same."""
        submap, shared = self.chain[f], self.shared[f]
        if previous is not None and f < len(previous.chain):
            last = previous.chain[f], previous.shared[f]
            if last[0] is submap and last[1] == shared:
                return previous.parts[f]
        return factor(submap, rows_of(submap, shared))

    def assemble(self, factors: int, data: Floats, gradient: Floats) -> float:
        """Write the normal equations of the first ``factors`` factors at the present values; the cost.

        Variables that none of them reaches get a unit pivot and no gradient.
        """
        data[:] = 0.0
        gradient[:] = 0.0
        p = self.pattern
        cost: float = _assemble(
            0, factors, self.invariant, self._variable_at, self._variables, self._estimate_at, self._information_at,
            self._estimates, self._informations, self.frames, self.points, p.begins, p.rows, p.within, p.start,
            p.pointers, data, gradient,
        )  # fmt: skip
        unreached = p.diagonal[data[p.diagonal] == 0.0]
        data[unreached] = 1.0
        return cost

    def place(self, f: int) -> None:
        """First values of what factor f reaches and none before it did: its end, its new landmarks."""
        submap, frame = self.chain[f], as_pose(self.frames[f])
        if np.isnan(self.frames[f + 1, 0]):
            self.frames[f + 1] = compose(frame, submap.pose)
        for number in self.shared[f]:
            i = self.variable_of[number] - len(self.chain)
            if np.isnan(self.points[i, 0]):
                at = submap.slot[number]
                self.points[i] = transform(frame, float(submap.mean[at]), float(submap.mean[at + 1]))

    def placed(self, number: int, inverse: InverseSubset) -> Placed:
        """A sub-map of the chain at the present values, with the joint covariance of its variables."""
        f = next(i for i, s in enumerate(self.chain) if s.number == number)
        shared = self.shared[f]
        variables = np.array([v for v in (f - 1, f, *(self.variable_of[i] for i in shared)) if v != FIXED])
        fixed = 3 if f == 0 else 0
        size = 6 + 2 * len(shared)
        covariance = np.zeros((size, size))
        covariance[fixed:, fixed:] = inverse.joint(variables)
        at = np.array([self.variable_of[i] - len(self.chain) for i in shared], dtype=np.int64)
        frame, end = as_pose(self.frames[f]), as_pose(self.frames[f + 1])
        return Placed(self.chain[f], frame, end, shared, self.points[at].reshape(-1, 2), covariance)

    def move(self, step: Floats) -> None:
        """Add an increment of all variables to their values."""
        poses = 3 * len(self.chain)
        self.frames[1:] += step[:poses].reshape(-1, 3)
        self.frames[:, 2] = np.remainder(self.frames[:, 2] + np.pi, 2.0 * np.pi) - np.pi
        self.points += step[poses:].reshape(-1, 2)


def _offsets(lengths: list[int]) -> Ints:
    return np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
