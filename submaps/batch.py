"""The full-batch optimum: every pose and every landmark at once, the measuring stick of the project.

Minimises  Σ ‖(R_aᵀ(p_b − p_a), θ_b − θ_a) − u‖²_Q + Σ ‖h(R_aᵀ(l − p_a)) − z‖²_R  over all poses
and landmarks, the origin held fixed; the residuals are additive, angles wrapped. Levenberg and
Marquardt on the sparse normal equations (Dellaert & Kaess, Square Root SAM, IJRR 25(12) 2006).
From dead reckoning it diverges, so the solution is grown: the poses enter in chunks, each begun
from the optimum of those before.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from submaps import residuals
from submaps.config import MotionConfig, ObservationConfig
from submaps.least_squares import Linearised, minimise
from submaps.measurements import Batch
from submaps.motion.increments import increments
from submaps.residuals import information_root, rotated, to_body

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Progress = Callable[[int, int], None]

CHUNK = 250  # poses that enter at a time; from 30 to 1 000 Victoria Park ends at the same optimum
_ROUGH, _FINE = 1e-4, 1e-13  # relative decrease of the cost that ends a chunk, and the whole


@dataclass(frozen=True)
class Optimum:
    """Where the cost is least.

    ``poses`` (n, 3), one a step (x m, y m, theta rad, not wrapped); ``landmarks`` (k, 2) in the
    order of ``ids``, that of first sighting; ``chi2`` the cost, the sum of squared whitened residuals.
    """

    poses: Floats
    ids: tuple[str, ...]
    landmarks: Floats
    chi2: float
    iterations: int


def optimum(
    batch: Batch,
    motion: MotionConfig,
    observation: ObservationConfig,
    *,
    chunk: int = CHUNK,
    progress: Progress | None = None,
) -> Optimum:
    """Batch optimum of a whole run, the first pose's frame being the origin.

    ``progress(done, total)`` is called with the poses solved so far. Raises ``NumericalError``
    where the problem is not determined or the cost cannot be brought to a minimum.
    """
    problem = _Problem.of(batch, motion, observation)
    state = _State(np.zeros((problem.poses, 3)), np.zeros((len(problem.ids), 2)))
    iterations, chi2, stop = 0, 0.0, 1
    while stop < problem.poses or iterations == 0:
        start, stop = stop, min(stop + chunk, problem.poses)
        problem.extend(state, start, stop)
        chi2, used = _settle(problem, state, stop, _FINE if stop == problem.poses else _ROUGH)
        iterations += used
        if progress is not None:
            progress(stop, problem.poses)
    return Optimum(state.poses[problem.pose_of_step], problem.ids, state.landmarks, chi2, iterations)


@dataclass
class _State:
    poses: Floats
    landmarks: Floats


@dataclass(frozen=True)
class _Problem:
    """The measurements: pose 0 is the origin, and each control leads to one pose more."""

    increment: Floats  # (c, 3)
    increment_root: Floats  # (c, 3, 3), W with Wᵀ W the information
    pose: Ints  # (m,) the pose that each observation was made from, not falling
    landmark: Ints  # (m,)
    z: Floats  # (m, 2)
    z_root: Floats  # (m, 2, 2)
    known: Ints  # (m,) landmarks known after each observation
    observation: ObservationConfig
    ids: tuple[str, ...]
    pose_of_step: Ints

    @staticmethod
    def of(batch: Batch, motion: MotionConfig, observation: ObservationConfig) -> _Problem:
        increment, noise = increments(motion, batch, None)
        pose_of_step = np.searchsorted(batch.control_step, np.arange(batch.steps), side="right")
        numbers: dict[str, int] = {}
        landmark = np.array([numbers.setdefault(name, len(numbers)) for name in batch.landmark], dtype=np.int64)
        z_noise = batch.observation_covariance
        if z_noise is None:
            z_noise = np.broadcast_to(np.diag(np.square(observation.sigma)), (batch.observations, 2, 2))
        return _Problem(
            increment=increment,
            increment_root=information_root(noise),
            pose=pose_of_step[batch.observation_step],
            landmark=landmark,
            z=np.ascontiguousarray(batch.z.T),
            z_root=information_root(z_noise),
            known=np.maximum.accumulate(landmark) + 1,
            observation=observation,
            ids=tuple(numbers),
            pose_of_step=pose_of_step,
        )

    @property
    def poses(self) -> int:
        return len(self.increment) + 1

    def observed(self, stop: int) -> int:
        """Number of observations made from the poses before ``stop``."""
        return int(np.searchsorted(self.pose, stop))

    def extend(self, state: _State, start: int, stop: int) -> None:
        """Begin new poses by dead reckoning, and new landmarks where they were first seen."""
        for k in range(start, stop):
            x, y, theta = state.poses[k - 1]
            c, s = np.cos(theta), np.sin(theta)
            dx, dy, dtheta = self.increment[k - 1]
            state.poses[k] = x + c * dx - s * dy, y + s * dx + c * dy, theta + dtheta
        first = 0 if start == 1 else self.observed(start)
        before = int(self.known[first - 1]) if first else 0
        rows = np.arange(first, self.observed(stop))
        numbers, where = np.unique(self.landmark[rows], return_index=True)
        rows = rows[where[numbers >= before]]
        pose = state.poses[self.pose[rows]]
        body = to_body(self.observation, self.z[rows])
        state.landmarks[self.landmark[rows]] = pose[:, :2] + rotated(pose[:, 2], body)


def _settle(problem: _Problem, state: _State, stop: int, tolerance: float) -> tuple[float, int]:
    """Bring the poses before ``stop`` and their landmarks to the least cost; changes ``state``."""
    free = 3 * (stop - 1)

    def moved(at: _State, step: Floats) -> _State:
        there = _State(at.poses.copy(), at.landmarks.copy())
        there.poses[1:stop] -= step[:free].reshape(-1, 3)
        there.landmarks[: (len(step) - free) // 2] -= step[free:].reshape(-1, 2)
        return there

    best, cost, iterations = minimise(lambda at: _linearise(problem, at, stop), moved, state, tolerance)
    state.poses, state.landmarks = best.poses, best.landmarks
    return cost, iterations


def _linearise(problem: _Problem, state: _State, stop: int) -> Linearised:
    """Whitened residuals of the poses before ``stop`` and their Jacobian, the origin's columns left out."""
    moved, moved_by = _motion_rows(problem, state, stop)
    seen, seen_by = _observation_rows(problem, state, stop)
    count = seen.shape[0]
    known = int(problem.known[count - 1]) if count else 0
    poses = np.arange(stop - 1)[:, None] * 3 + np.arange(6)
    observed = np.hstack(
        [
            3 * problem.pose[:count, None] + np.arange(3),
            3 * stop + 2 * problem.landmark[:count, None] + np.arange(2),
        ]
    )
    columns = np.concatenate([np.repeat(poses, 3, axis=0).ravel(), np.repeat(observed, 2, axis=0).ravel()])
    split = 18 * (stop - 1)
    starts = np.concatenate([np.arange(0, split, 6), np.arange(split, split + 10 * count + 1, 5)])
    values = np.concatenate([moved_by.ravel(), seen_by.ravel()])
    residual = np.concatenate([moved.ravel(), seen.ravel()])
    shape = (residual.shape[0], 3 * stop + 2 * known)
    jacobian = sparse.csr_matrix((values, columns, starts), shape=shape).tocsc()[:, 3:]
    return Linearised(float(residual @ residual), residual, jacobian)


def _motion_rows(problem: _Problem, state: _State, stop: int) -> tuple[Floats, Floats]:
    """Residuals (c, 3) and their derivatives (c, 3, 6) by the poses before and after."""
    pose, moves = state.poses[:stop], slice(stop - 1)
    return residuals.moved(pose[:-1], pose[1:], problem.increment[moves], problem.increment_root[moves])


def _observation_rows(problem: _Problem, state: _State, stop: int) -> tuple[Floats, Floats]:
    """Residuals (m, 2) and their derivatives (m, 2, 5) by pose and landmark."""
    rows = slice(problem.observed(stop))
    pose, point = state.poses[problem.pose[rows]], state.landmarks[problem.landmark[rows]]
    return residuals.seen(pose, point, problem.observation, problem.z[rows], problem.z_root[rows])
