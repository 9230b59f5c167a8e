"""Known association: what is seen says which landmark it is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps.association.candidates import Candidates
from submaps.association.result import NEW, Association

Ints = NDArray[np.int64]


def known(candidates: Candidates, identities: Ints, held: Ints) -> Association:
    """Observations of ``identities`` (m,) among landmarks that are ``held`` (n,); without gates.

    An identity that no landmark has is new.
    """
    m = candidates.observations
    same = identities[:, np.newaxis] == held[np.newaxis, :]
    landmark = np.where(same.any(axis=1), same.argmax(axis=1), NEW) if held.size else np.full(m, NEW)
    squared = np.full(m, np.inf)
    rows = np.flatnonzero(landmark >= 0)
    squared[rows] = candidates.squared[rows, landmark[rows]]
    return Association(landmark, landmark, squared)
