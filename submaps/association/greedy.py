"""Greedy association: the likeliest pair first, each landmark to one observation."""

from __future__ import annotations

import numpy as np

from submaps.association.candidates import Candidates
from submaps.association.result import NEW, Association, Gates, settled


def greedy(candidates: Candidates, gates: Gates) -> Association:
    """Take pairs within the gate in the order of ``Candidates.distance``, as long as both are free.

    The distance and not d^2 orders them, or the vaguest landmark would take readings from its neighbours.
    Equal ones are taken in the order of the observations, then of the landmarks.
    """
    chosen = np.full(candidates.observations, NEW, dtype=np.int64)
    i, j = np.nonzero(candidates.squared <= gates.bound(candidates.readings.dimension))
    order = np.argsort(candidates.distance[i, j], kind="stable")
    taken: set[int] = set()
    for observation, landmark in zip(i[order].tolist(), j[order].tolist(), strict=True):
        if chosen[observation] < 0 and landmark not in taken:
            chosen[observation] = landmark
            taken.add(landmark)
    return settled(candidates, gates, chosen)
