"""The full-batch optimum: every pose and every landmark at once, the measuring stick of the project.

Minimises  Σ ‖(R_aᵀ(p_b − p_a), θ_b − θ_a) − u‖²_Q + Σ ‖h(R_aᵀ(l − p_a)) − z‖²_R  over all poses
and landmarks, the origin held fixed (in space the rotations' part is that of ``space_residuals``). Levenberg and
Marquardt on the sparse normal equations (Dellaert & Kaess, Square Root SAM, IJRR 25(12) 2006).
From dead reckoning it diverges, so the solution is grown: the poses enter in chunks, each begun
from the optimum of those before. Without a motion model only the second sum is left (bundle adjustment); a pose
then begins where at least three known landmarks put it. Where readings leave the depth open, its prior counts once,
at a landmark's first reading.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from submaps.batch_problem import Problem, State
from submaps.config import MotionConfig, ObservationConfig
from submaps.least_squares import minimise
from submaps.measurements import Batch

Floats = NDArray[np.float64]
Progress = Callable[[int, int], None]

CHUNK = 250  # poses that enter at a time; from 30 to 1 000 Victoria Park ends at the same optimum
_ROUGH, _FINE = 1e-4, 1e-13  # relative decrease of the cost that ends a chunk, and the whole
# Without motion a few poses hang on three landmarks nearly in a line and settle last, on their own.
_FINE_WITHOUT_MOTION = 1e-8


@dataclass(frozen=True)
class Optimum:
    """Where the cost is least.

    ``poses`` (n, 3), one a step (x m, y m, theta rad, not wrapped), in space (n, 6) (x, y, z m, rotation vector
    rad), NaN where nothing says where the robot was; ``landmarks`` (k, dim) in the order of ``ids``, that of first
    sighting; ``chi2`` the cost, the sum of squared whitened residuals, and ``freedom`` what it is about where the
    noise is as stated: residuals less unknowns.
    """

    poses: Floats
    ids: tuple[str, ...]
    landmarks: Floats
    chi2: float
    iterations: int
    freedom: int


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
    problem = Problem.of(batch, motion, observation)
    space = problem.space
    state = State(np.zeros((problem.poses, space.pose)), np.zeros((len(problem.ids), space.dim)))
    fine = _FINE_WITHOUT_MOTION if motion.model == "none" else _FINE
    iterations, chi2, stop = 0, 0.0, 0
    while stop < problem.poses or iterations == 0:
        start, stop = stop, min(max(stop, 1) + chunk, problem.poses)
        problem.extend(state, start, stop)
        chi2, used = _settle(problem, state, stop, fine if stop == problem.poses else _ROUGH)
        iterations += used
        if progress is not None:
            progress(stop, problem.poses)
    poses = np.where(problem.pose_of_step[:, np.newaxis] >= 0, state.poses[problem.pose_of_step], np.nan)
    return Optimum(poses, problem.ids, state.landmarks, chi2, iterations, problem.freedom)


def _settle(problem: Problem, state: State, stop: int, tolerance: float) -> tuple[float, int]:
    """Bring the poses before ``stop`` and their landmarks to the least cost; changes ``state``."""
    best, cost, iterations = minimise(
        lambda at: problem.linearise(at, stop), lambda at, step: problem.moved_back(at, stop, step), state, tolerance
    )
    state.poses, state.landmarks = best.poses, best.landmarks
    return cost, iterations
