"""The batch optimum of several robots on one map: landmarks, and the poses from which or at which something was seen.

The cost is that of ``batch``, with each robot's increments composed between those poses, and sightings
of one another: z = h(R_aᵀ(p_b − p_a)), with p_b the other robot's position at that time. The origin is
the first robot's first pose.

With a gate, readings that the optimum calls less likely than that are left out, and let in again where
a later one finds them likely, until the set stays as it is. On the way there Cauchy's
ρ(s) = c² log(1 + s/c²) of a reading's whitened square s stands in for the gate, because from a begin
value that is off no reading looks likely (Triggs et al., "Bundle adjustment: a modern synthesis", 2000).

Each robot is first grown alone, from its landmarks; the others are then laid over those before by what
they have in common, landmarks and sightings alike, and all are solved at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from submaps.alignment import align
from submaps.config import MotionConfig, ObservationConfig
from submaps.consistency import chi_square_bound
from submaps.errors import NumericalError
from submaps.fleet_problem import Kernel, Problem, cauchy, plain, problem_of
from submaps.measurements import Batch
from submaps.residuals import rotated, to_body
from submaps.trajectory import Trajectory

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Progress = Callable[[int, int], None]

# Poses of one robot that enter at a time, and those that give way to them at once; all do now and then.
CHUNK, WINDOW = 10, 60
_ROUGH, _ENOUGH, _FINE = (
    1e-4,
    30,
    1e-10,
)  # relative decrease of the cost (or iterations) that end a chunk, and the whole
_ORIGIN = np.arange(3)
_ROUNDS = 20  # of the gate
_OVERLAYS = 6  # of a robot over the others, the worst of what they have in common left out more and more


@dataclass(frozen=True)
class FleetOptimum:
    """Where the cost is least, in the frame of the first robot's first pose.

    ``landmarks`` (k, 2) in the order of ``ids``; ``trajectories`` by robot, at the steps that saw
    something (theta not wrapped); ``used`` by robot, for each observation; ``chi2`` the cost.
    """

    ids: tuple[str, ...]
    landmarks: Floats
    trajectories: Mapping[str, Trajectory]
    used: Mapping[str, Bools]
    chi2: float


@dataclass(frozen=True)
class Guess:
    """Begin values in one frame: landmarks (2,) by id, and each robot's poses."""

    landmarks: Mapping[str, Floats]
    trajectories: Mapping[str, Trajectory]


def fleet_optimum(
    robots: Mapping[str, Batch],
    motion: MotionConfig,
    observation: ObservationConfig,
    *,
    gate: float | None = None,
    guess: Guess | None = None,
    progress: Progress | None = None,
) -> FleetOptimum:
    """Batch optimum of all robots' measurements; ``gate`` is a χ² probability, ``None`` uses every reading.

    ``progress(done, total)`` counts poses of robots grown alone. Raises ``NumericalError`` where
    nothing ties a robot to the others, or the cost cannot be brought to a minimum.
    """
    problem = problem_of(robots, motion, observation)
    kernel = plain if gate is None else cauchy
    x = _overlaid(problem, kernel, progress) if guess is None else _guessed(problem, robots, guess)
    moves, rows = np.arange(len(problem.before)), np.arange(len(problem.pose))
    if gate is None:
        x, cost = problem.settle(x, _ORIGIN, moves, rows, plain, _FINE)
    else:
        x, _ = problem.settle(x, _ORIGIN, moves, rows, cauchy, _ROUGH, _ENOUGH)
        x, cost, rows = _gated(problem, x, moves, chi_square_bound(gate, 2))
    return _told(problem, robots, x, cost, rows)


def _gated(problem: Problem, x: Floats, moves: Ints, bound: float) -> tuple[Floats, float, Ints]:
    """Least squares over the readings that lie inside the gate when it is reached."""
    every = np.arange(len(problem.pose))
    rows = np.empty(0, dtype=np.int64)
    cost = 0.0
    for _ in range(_ROUNDS):
        squares = np.sum(problem.residual(x, every)[0] ** 2, axis=1)
        inside = np.flatnonzero(squares < bound)
        if np.array_equal(inside, rows):
            break
        rows = inside
        x, cost = problem.settle(x, _ORIGIN, moves, rows, plain, _FINE)
    return x, cost, rows


# -- begin values --------------------------------------------------------------------------------


def _overlaid(problem: Problem, kernel: Kernel, progress: Progress | None) -> Floats:
    """Each robot grown alone, and laid over those before that it has most in common with."""
    grown = [_grown(problem, k, kernel, progress) for k in range(len(problem.names))]
    x = grown[0]
    waiting = list(range(1, len(grown)))
    while waiting:
        common = {k: _in_common(problem, k, grown[k], x) for k in waiting}
        k = max(waiting, key=lambda k: len(common[k][0]))
        if len(common[k][0]) < 2:
            raise NumericalError(f"nothing ties robot {problem.names[k]!r} to the others")
        _lay_over(problem, x, grown[k], *common[k])
        waiting.remove(k)
    return x


def _grown(problem: Problem, k: int, kernel: Kernel, progress: Progress | None) -> Floats:
    """Robot k alone, its first pose at the origin; NaN for all that it does not know."""
    x = np.full(3 * problem.poses + 2 * len(problem.ids), np.nan)
    first, end = int(problem.first[k]), int(problem.first[k + 1])
    origin = 3 * first + np.arange(3)
    x[origin] = 0.0
    moves = np.flatnonzero((problem.before >= first) & (problem.before < end))
    rows = np.flatnonzero((problem.robot == k) & problem.of_landmark)
    start, whole = first + 1, first + WINDOW
    while start < end or start == first + 1:
        stop = min(start + CHUNK, end)
        _dead_reckon(problem, x, moves[start - first - 1 : stop - first - 1])
        seen = rows[problem.pose[rows] < stop]
        old = max(stop - WINDOW, first)
        held = _known(problem, x, old) if old > first else origin
        _first_sightings(problem, x, seen)
        late = seen[problem.pose[seen] >= old]
        x, _ = problem.settle(x, held, moves[old - first : stop - first - 1], late, kernel, _ROUGH, _ENOUGH)
        if stop >= whole or stop == end:
            x, _ = problem.settle(x, origin, moves[: stop - first - 1], seen, kernel, _ROUGH, _ENOUGH)
            whole = first + int(1.1 * (stop - first)) + WINDOW
        start = max(stop, start + 1)
        if progress is not None:
            progress(stop, problem.poses)
    return x


def _known(problem: Problem, x: Floats, pose: int) -> Ints:
    """The columns of a pose, and of the landmarks that have a value."""
    split = 3 * problem.poses
    return np.concatenate([3 * pose + np.arange(3), split + np.flatnonzero(~np.isnan(x[split:]))])


def _dead_reckon(problem: Problem, x: Floats, moves: Ints) -> None:
    for i in moves.tolist():
        at = 3 * int(problem.before[i])
        heading, (dx, dy, turn) = x[at + 2], problem.increment[i]
        c, s = np.cos(heading), np.sin(heading)
        x[at + 3 : at + 6] = x[at] + c * dx - s * dy, x[at + 1] + s * dx + c * dy, heading + turn


def _shown(problem: Problem, x: Floats, rows: Ints) -> Floats:
    """The points (m, 2) that readings show from where their poses are."""
    pose = x[3 * problem.pose[rows, None] + np.arange(3)]
    moved: Floats = pose[:, :2] + rotated(pose[:, 2], to_body(problem.observation, problem.z[rows]))
    return moved


def _first_sightings(problem: Problem, x: Floats, rows: Ints) -> None:
    """Put landmarks without a value where their first reading shows them."""
    new = rows[np.isnan(x[problem.target[rows]])]
    _, where = np.unique(problem.target[new], return_index=True)
    new = new[where]
    x[problem.target[new, None] + np.arange(2)] = _shown(problem, x, new)


def _in_common(problem: Problem, k: int, own: Floats, x: Floats) -> tuple[Floats, Floats]:
    """The same points (n, 2) as robot k has them and as those already laid out do."""
    marks = 3 * problem.poses + 2 * np.arange(len(problem.ids))
    marks = marks[~np.isnan(own[marks]) & ~np.isnan(x[marks])]
    marks = marks[:, None] + np.arange(2)
    rows = np.flatnonzero(~problem.of_landmark)
    viewer, seen = 3 * problem.pose[rows], problem.target[rows]
    by, of = rows[~np.isnan(own[viewer]) & ~np.isnan(x[seen])], rows[~np.isnan(x[viewer]) & ~np.isnan(own[seen])]
    return (
        np.concatenate([own[marks], _shown(problem, own, by), own[problem.target[of, None] + np.arange(2)]]),
        np.concatenate([x[marks], x[problem.target[by, None] + np.arange(2)], _shown(problem, x, of)]),
    )


def _lay_over(problem: Problem, x: Floats, own: Floats, there: Floats, here: Floats) -> None:
    """Move a robot's poses and its own landmarks onto the rest; changes ``x``."""
    for _ in range(_OVERLAYS):
        motion = align(there, here)
        distance = np.hypot(*(motion.apply(there) - here).T)
        near = distance <= 3.0 * np.median(distance)
        if near.all():
            break
        there, here = there[near], here[near]
    known = ~np.isnan(own)
    split = 3 * problem.poses
    poses, marks = np.flatnonzero(known[:split:3]), np.flatnonzero(known[split::2] & np.isnan(x[split::2]))
    moved = own[3 * poses[:, None] + np.arange(3)]
    moved[:, :2] = motion.apply(moved[:, :2])
    moved[:, 2] += motion.theta
    x[3 * poses[:, None] + np.arange(3)] = moved
    columns = split + 2 * marks[:, None] + np.arange(2)
    x[columns] = motion.apply(own[columns])


def _guessed(problem: Problem, robots: Mapping[str, Batch], guess: Guess) -> Floats:
    """Begin values from outside, carried along the increments where they have none."""
    x = np.full(3 * problem.poses + 2 * len(problem.ids), np.nan)
    for k, (name, batch) in enumerate(robots.items()):
        first = int(problem.first[k])
        rows = np.flatnonzero(problem.robot == k)
        t = batch.t[batch.observation_step[problem.row[rows]]]
        begin = guess.trajectories[name]
        x[3 * first : 3 * first + 3] = begin.poses[0]
        near = begin.poses[np.clip(np.searchsorted(begin.t, t), 0, len(begin) - 1)]
        x[3 * problem.pose[rows, None] + np.arange(3)] = near
        moves = np.flatnonzero((problem.before >= first) & (problem.before < problem.first[k + 1]))
        _dead_reckon(problem, x, moves[np.isnan(x[3 * problem.before[moves] + 3])])
    for j, name in enumerate(problem.ids):
        if name in guess.landmarks:
            at = 3 * problem.poses + 2 * j
            x[at : at + 2] = guess.landmarks[name]
    _first_sightings(problem, x, np.flatnonzero(problem.of_landmark))
    return x


def _told(problem: Problem, robots: Mapping[str, Batch], x: Floats, cost: float, rows: Ints) -> FleetOptimum:
    trajectories, used = {}, {}
    for k, (name, batch) in enumerate(robots.items()):
        own = np.flatnonzero(problem.robot == k)
        step, where = np.unique(batch.observation_step[problem.row[own]], return_index=True)
        trajectories[name] = Trajectory(batch.t[step], x[3 * problem.pose[own[where], None] + np.arange(3)])
        used[name] = np.zeros(batch.observations, dtype=bool)
        used[name][problem.row[rows[problem.robot[rows] == k]]] = True
    landmarks = x[3 * problem.poses :].reshape(-1, 2)
    return FleetOptimum(problem.ids, landmarks, trajectories, used, cost)
