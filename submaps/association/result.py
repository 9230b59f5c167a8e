"""What every method of association answers, and the two gates that all of them keep to."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from submaps.association.candidates import Candidates
from submaps.consistency import chi_square_bound

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

NEW, AMBIGUOUS = -1, -2
_bound = lru_cache(maxsize=4096)(chi_square_bound)


@dataclass(frozen=True)
class Gates:
    """Two chi-square probabilities of the squared distance to a landmark.

    Within ``match`` an observation may be of the landmark. Beyond ``new`` from every landmark it begins
    one. In between it is too far to be sure of and too near to be another: clutter beside a landmark
    neither updates it nor begins a second one.
    """

    match: float
    new: float

    def bound(self, dof: int) -> float:
        """Largest squared distance of a match of ``dof`` degrees of freedom."""
        return _bound(self.match, dof)

    def new_bound(self, dof: int) -> float:
        """Squared distance of one reading beyond which there is no landmark."""
        return _bound(self.new, dof)


@dataclass(frozen=True)
class Association:
    """For each of m observations the landmark it is of: its index, ``NEW`` or ``AMBIGUOUS``.

    ``nearest`` (m,) is the landmark matched, or else that at the smallest squared distance (-1: there is
    none), and ``squared`` (m,) that distance. ``nodes`` counts the pairs that a search tried;
    ``complete`` is false where it was cut short.
    """

    landmark: Ints
    nearest: Ints
    squared: Floats
    nodes: int = 0
    complete: bool = True

    @property
    def matched(self) -> NDArray[np.bool_]:
        """Which observations are of a landmark (m,)."""
        return self.landmark >= 0


def settled(
    candidates: Candidates, gates: Gates, chosen: Ints, *, nodes: int = 0, complete: bool = True
) -> Association:
    """The answer where ``chosen`` (m,) holds landmarks, below 0 for none: what is left is new or ambiguous.

    An observation near a landmark that another one has is ambiguous, for two readings of one landmark in
    one step cannot both be right.
    """
    m = candidates.observations
    if candidates.landmarks == 0:
        nothing = np.full(m, NEW, dtype=np.int64)
        return Association(nothing, nothing, np.full(m, np.inf), nodes, complete)
    nearest = np.argmin(candidates.squared, axis=1)
    near = candidates.squared[np.arange(m), nearest] <= gates.new_bound(candidates.readings.dimension)
    landmark = np.where(chosen >= 0, chosen, np.where(near, AMBIGUOUS, NEW))
    nearest = np.where(chosen >= 0, chosen, nearest)
    return Association(landmark, nearest, candidates.squared[np.arange(m), nearest], nodes, complete)
