"""How well an estimate's covariance describes its error: NEES, NIS and their chi-square bounds.

Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001,
section 5.4.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

Floats = NDArray[np.float64]


def chi_square_bound(probability: float, dof: int) -> float:
    """The value that a chi-square variable of ``dof`` degrees of freedom stays below so often.

    Kept to twelve digits, so that a gate does not depend on the library that computed it.
    """
    return float(f"{2.0 * gammaincinv(0.5 * dof, probability):.12g}")


def nees(error: Floats, covariance: Floats) -> float:
    """Normalised estimation error squared, e^T P^-1 e, of an error (d,) and covariance (d, d)."""
    return float(error @ np.linalg.solve(covariance, error))


def average_bounds(probability: float, dof: int, runs: int) -> tuple[float, float]:
    """Bounds of the mean of ``runs`` NEES values, per degree of freedom, for a consistent filter."""
    tail = 0.5 * (1.0 - probability)
    total = dof * runs
    return chi_square_bound(tail, total) / total, chi_square_bound(1.0 - tail, total) / total
