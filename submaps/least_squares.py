"""Levenberg and Marquardt on sparse normal equations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import qdldl
import scipy.sparse as sparse
from numpy.typing import NDArray

from submaps.errors import NumericalError

Floats = NDArray[np.float64]
State = TypeVar("State")

MAX_ITERATIONS = 100


@dataclass(frozen=True)
class Linearised:
    """The cost at a state, and the residuals (m,) and Jacobian (m, n) whose normal equations lead on from it.

    The cost is the sum of squared residuals, or of a robust function of them, the rows weighted accordingly.
    """

    cost: float
    residual: Floats
    jacobian: sparse.csc_matrix


def minimise(
    linearise: Callable[[State], Linearised],
    moved: Callable[[State, Floats], State],
    state: State,
    tolerance: float,
    enough: int | None = None,
) -> tuple[State, float, int]:
    """The state of least cost, its cost, and the iterations it took.

    ``moved(state, step)`` subtracts a step (n,); ``tolerance`` is the relative decrease of the cost
    that ends it, and ``enough`` a number of iterations that does. Raises ``NumericalError`` where the
    problem is not determined or, without ``enough``, no end is reached.
    """
    damping = 0.0
    at = linearise(state)
    for iteration in range(1, (enough or MAX_ITERATIONS) + 1):
        step = _solve((at.jacobian.T @ at.jacobian).tocsc(), at.jacobian.T @ at.residual, damping)
        trial = moved(state, step)
        there = linearise(trial)
        gained = at.cost - there.cost
        settled = abs(gained) <= tolerance * at.cost + 1e-12
        if gained >= 0.0:
            state, at = trial, there
            damping = 0.0 if damping < 1e-8 else damping / 10.0
        else:
            damping = max(10.0 * damping, 1e-6)
        if settled or iteration == enough:
            return state, at.cost, iteration
    raise NumericalError(f"the batch optimum was not reached in {MAX_ITERATIONS} iterations, cost {at.cost:.6g}")


def _solve(hessian: sparse.csc_matrix, gradient: Floats, damping: float) -> Floats:
    if damping:
        hessian = (hessian + damping * sparse.diags(hessian.diagonal())).tocsc()
    if gradient.shape[0] == 0:
        return gradient
    try:
        step: Floats = qdldl.Solver(hessian).solve(gradient)
    except (RuntimeError, ValueError) as error:
        raise NumericalError(f"the batch problem is not determined: {error}") from error
    if not np.all(np.isfinite(step)):
        raise NumericalError("the batch problem is not determined: its solution is not finite")
    return step
