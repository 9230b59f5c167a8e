"""The batch problem of several robots as arrays: what leads from pose to pose, and what was read from where."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from submaps import residuals
from submaps.chains import Chain, chain, place_at, place_of_steps
from submaps.config import MotionConfig, ObservationConfig
from submaps.least_squares import Linearised, minimise
from submaps.measurements import Batch, as_encounter

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
# From squared whitened residuals (m,) to their costs and the weights of their squares.
Kernel = Callable[[Floats], tuple[Floats, Floats]]

_LANDMARK, _NOBODY = -1, -2
CAUCHY = 2.0  # standard deviations from which a reading begins to lose weight


def plain(squares: Floats) -> tuple[Floats, Floats]:
    """Least squares."""
    return squares, np.ones_like(squares)


def cauchy(squares: Floats) -> tuple[Floats, Floats]:
    """ρ(s) = c² log(1 + s/c²) and its slope."""
    scaled = squares / CAUCHY**2
    return CAUCHY**2 * np.log1p(scaled), 1.0 / (1.0 + scaled)


@dataclass(frozen=True)
class Problem:
    """Unknowns are one vector: poses (x, y, theta each), robot after robot, then landmarks (x, y each).

    ``first`` (r + 1,) is each robot's first pose, and the number of all. Pose ``before[i]`` and the
    next are tied by ``increment[i]``. Reading j was made from ``pose[j]`` (not falling within a
    robot, which is ``robot[j]``) of the point in columns ``target[j]`` and the next: a landmark's, or
    the position of a pose. ``row`` is its place among its robot's observations.
    """

    names: tuple[str, ...]
    ids: tuple[str, ...]
    first: Ints
    before: Ints
    increment: Floats
    increment_root: Floats
    robot: Ints
    row: Ints
    pose: Ints
    target: Ints
    z: Floats
    z_root: Floats
    observation: ObservationConfig

    @property
    def poses(self) -> int:
        """Number of poses of all robots."""
        return int(self.first[-1])

    @property
    def of_landmark(self) -> NDArray[np.bool_]:
        """Which readings are of landmarks rather than of robots."""
        return self.target >= 3 * self.poses

    def residual(self, x: Floats, rows: Ints) -> tuple[Floats, Floats]:
        """Whitened residuals (m, 2) of readings, and their derivatives (m, 2, 5) by pose and point."""
        pose, point = x[3 * self.pose[rows, None] + np.arange(3)], x[self.target[rows, None] + np.arange(2)]
        return residuals.seen(pose, point, self.observation, self.z[rows], self.z_root[rows])

    def _pattern(self, size: int, held: Ints, moves: Ints, rows: Ints) -> tuple[Ints, Ints, Ints]:
        """The columns that are free, and the Jacobian's pattern over them and one more for all that is held."""
        by_move = 3 * self.before[moves, None] + np.arange(6)
        by_reading = np.hstack([3 * self.pose[rows, None] + np.arange(3), self.target[rows, None] + np.arange(2)])
        free = np.setdiff1d(np.concatenate([by_move.ravel(), by_reading.ravel()]), held)
        column = np.full(size, free.shape[0])
        column[free] = np.arange(free.shape[0])
        columns = [np.repeat(column[by_move], 3, axis=0).ravel(), np.repeat(column[by_reading], 2, axis=0).ravel()]
        split = 18 * len(moves)
        starts = np.concatenate([np.arange(0, split, 6), np.arange(split, split + 10 * len(rows) + 1, 5)])
        return free, np.concatenate(columns), starts

    def settle(
        self,
        x: Floats,
        held: Ints,
        moves: Ints,
        rows: Ints,
        kernel: Kernel,
        tolerance: float,
        enough: int | None = None,
    ) -> tuple[Floats, float]:
        """The least cost over the unknowns that some moves and readings speak of and that are not ``held``.

        Returns all unknowns where it is least, and the cost.
        """
        free, columns, starts = self._pattern(x.shape[0], held, moves, rows)
        shape = (starts.shape[0] - 1, free.shape[0] + 1)

        def linearise(at: Floats) -> Linearised:
            before = at[3 * self.before[moves, None] + np.arange(3)]
            after = at[3 * self.before[moves, None] + np.arange(3, 6)]
            moved, moved_by = residuals.moved(before, after, self.increment[moves], self.increment_root[moves])
            seen, seen_by = self.residual(at, rows)
            costs, weights = kernel(np.sum(seen**2, axis=1))
            root = np.sqrt(weights)[:, np.newaxis]
            residual = np.concatenate([moved.ravel(), (root * seen).ravel()])
            values = np.concatenate([moved_by.ravel(), (root[:, :, np.newaxis] * seen_by).ravel()])
            jacobian = sparse.csr_matrix((values, columns, starts), shape=shape).tocsc()[:, :-1]
            return Linearised(float(np.sum(moved**2) + np.sum(costs)), residual, jacobian)

        def moved_on(at: Floats, step: Floats) -> Floats:
            there = at.copy()
            there[free] -= step
            return there

        best, cost, _ = minimise(linearise, moved_on, x, tolerance, enough)
        return best, cost


@dataclass(frozen=True)
class _Seen:
    """Whom each of a robot's observations shows: a landmark, another robot at a place of its chain, or nobody here."""

    other: Ints
    place: Floats

    @staticmethod
    def by(batch: Batch, robots: Mapping[str, Batch]) -> _Seen:
        number = {name: k for k, name in enumerate(robots)}
        met = [as_encounter(name) for name in batch.landmark]
        other = np.array([_LANDMARK if one is None else number.get(one[0], _NOBODY) for one in met], dtype=np.int64)
        t = np.array([np.nan if one is None else one[1] for one in met])
        place = np.full(len(met), np.nan)
        for k, seen in enumerate(robots.values()):
            place[other == k] = place_at(seen, t[other == k])
        return _Seen(np.where((other >= 0) & np.isnan(place), _NOBODY, other), place)


def problem_of(robots: Mapping[str, Batch], motion: MotionConfig, observation: ObservationConfig) -> Problem:
    """The problem of some robots' measurements.

    A sighting of a robot at a time when it has no pose, or of one that is not among the robots, is
    not in it.
    """
    seen = [_Seen.by(batch, robots) for batch in robots.values()]
    own = [place_of_steps(batch)[batch.observation_step].astype(np.float64) for batch in robots.values()]
    chains = [
        chain(batch, motion, np.concatenate([own[k], *(one.place[one.other == k] for one in seen)]))
        for k, batch in enumerate(robots.values())
    ]
    first = np.concatenate([[0], np.cumsum([len(one) for one in chains])])
    ids: dict[str, int] = {}
    parts = []
    for k, batch in enumerate(robots.values()):
        kept = np.flatnonzero(seen[k].other != _NOBODY)
        target = _targets(batch, seen[k], chains, first, ids)[kept]
        covariance = batch.observation_covariance
        if covariance is None:
            covariance = np.broadcast_to(np.diag(np.square(observation.sigma)), (batch.observations, 2, 2))
        root = residuals.information_root(covariance[kept])
        parts.append((np.full(len(kept), k), kept, first[k] + chains[k].index(own[k][kept]), target,
                      batch.z.T[kept], root))  # fmt: skip
    robot, row, pose, target, z, z_root = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Problem(
        names=tuple(robots), ids=tuple(ids), first=first, before=np.setdiff1d(np.arange(first[-1]), first[1:] - 1),
        increment=np.concatenate([one.increment for one in chains]),
        increment_root=residuals.information_root(np.concatenate([one.covariance for one in chains])),
        robot=robot, row=row, pose=pose, target=target, z=z, z_root=z_root, observation=observation,
    )  # fmt: skip


def _targets(batch: Batch, seen: _Seen, chains: list[Chain], first: Ints, ids: dict[str, int]) -> Ints:
    """First columns of what each observation shows; ``ids`` grows with the landmarks."""
    target = np.full(batch.observations, -1, dtype=np.int64)
    for i in np.flatnonzero(seen.other == _LANDMARK).tolist():
        target[i] = 3 * first[-1] + 2 * ids.setdefault(batch.landmark[i], len(ids))
    for k, one in enumerate(chains):
        rows = seen.other == k
        target[rows] = 3 * (first[k] + one.index(seen.place[rows]))
    return target
