"""Association as an assignment problem: the pairs of a step chosen together, each apart from its neighbours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from submaps.association.candidates import Candidates
from submaps.association.result import NEW, Association, Gates, settled

Floats = NDArray[np.float64]


def costs(candidates: Candidates, gates: Gates) -> Floats:
    """The rectangular cost (m, n + m) whose least sum is the answer.

    A pair within its gate costs ``Candidates.distance``, for which |S| matters: costs of different
    landmarks are weighed against each other. Beyond the gate it costs infinity. Column n + i lets
    observation i have no landmark; it costs what a reading at the gate of the vaguest landmark in question
    costs, so that no free landmark within its gate is left. A landmark without a measurement costs
    nothing: with one probability of detection for all it is a constant, which that cost stands for.
    """
    m, n = candidates.squared.shape
    bound = gates.bound(candidates.readings.dimension)
    within = candidates.squared <= bound
    cost = np.full((m, n + m), np.inf)
    cost[:, :n][within] = candidates.distance[within]
    vaguest = np.max(candidates.distance[within] - candidates.squared[within], initial=0.0)
    cost[np.arange(m), n + np.arange(m)] = bound + vaguest
    return cost


def assignment(candidates: Candidates, gates: Gates) -> Association:
    """Solve the assignment with ``scipy.optimize.linear_sum_assignment``.

    Among equal sums it takes one by its order of search: the same one for the same costs.
    """
    cost = costs(candidates, gates)
    chosen = np.full(candidates.observations, NEW, dtype=np.int64)
    if np.isfinite(cost[:, : candidates.landmarks]).any():
        rows, columns = linear_sum_assignment(cost)
        chosen[rows] = np.where(columns < candidates.landmarks, columns, NEW)
    return settled(candidates, gates, chosen)
