"""How well an estimate's covariance describes its error: NEES, NIS and their chi-square bounds.

Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001,
section 5.4.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from submaps.geometry.space import Pose, Space

Floats = NDArray[np.float64]


def chi_square_bound(probability: float, dof: int) -> float:
    """The value that a chi-square variable of ``dof`` degrees of freedom stays below so often.

    Kept to twelve digits, so that a gate does not depend on the library that computed it.
    """
    return float(f"{2.0 * gammaincinv(0.5 * dof, probability):.12g}")


def nees(error: Floats, covariance: Floats) -> float:
    """Normalised estimation error squared, e^T P^-1 e, of an error (d,) and covariance (d, d)."""
    return float(error @ np.linalg.solve(covariance, error))


def additive_error(space: Space, truth: Pose, estimate: Pose) -> Floats:
    """The error (pose,) that takes an estimate to the truth: e_p = p - p^, exp(e_theta) = R R^^T."""
    turned = space.angles_of(space.rotation(truth) @ space.rotation(estimate).T)
    return np.concatenate([np.array(truth[: space.dim]) - estimate[: space.dim], turned])


def invariant_nees(space: Space, truth: Pose, estimate: Pose, covariance: Floats) -> float:
    """NEES of a pose in the coordinates of the right-invariant filter, in which its error is normal.

    p = exp(xi_theta) p^ + V xi_p, R = exp(xi_theta) R^ (Zhang et al., arXiv:1702.06680). ``covariance`` (pose, pose)
    is of the additive errors; to first order xi_p = e_p - turn(p^) e_theta.
    """
    dim = space.dim
    error = additive_error(space, truth, estimate)
    turned = space.rotation_of(error[dim:]) @ np.array(estimate[:dim])
    error[:dim] = np.linalg.solve(space.left_jacobian(error[dim:]), np.array(truth[:dim]) - turned)
    T = np.eye(space.pose)
    T[:dim, dim:] = -space.turn(np.array(estimate[:dim]))
    return nees(error, T @ covariance @ T.T)


def average_bounds(probability: float, dof: int, runs: int) -> tuple[float, float]:
    """Bounds of the mean of ``runs`` NEES values, per degree of freedom, for a consistent filter."""
    tail = 0.5 * (1.0 - probability)
    total = dof * runs
    return chi_square_bound(tail, total) / total, chi_square_bound(1.0 - tail, total) / total
