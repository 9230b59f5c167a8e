"""How far a map lies from the true points (eqs 26 and 27), and how much of that is its shape."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps.consistency import nees
from submaps.nonodometry.belief import Belief

Floats = NDArray[np.float64]


def euclidean(points: Floats, truth: Floats) -> float:
    """Σ ‖m_k − m̂_k‖ (m) over points (n, 3) as they come (eq. 26)."""
    return float(np.linalg.norm(points - truth, axis=1).sum())


def mahalanobis(belief: Belief, truth: Floats) -> float:
    """(m̂ − m)ᵀ P⁻¹ (m̂ − m)/dim m (eq. 27): 1 on average where the covariance tells the truth."""
    return nees((belief.points - truth).ravel(), belief.covariance) / truth.size


def shape(points: Floats, truth: Floats) -> float:
    """Eq. 26 after the similarity that lays the points over the truth best: what is left without the gauge."""
    return euclidean(similar(points, truth), truth)


def similar(points: Floats, truth: Floats) -> Floats:
    """s R m̂ + t of least Σ‖s R m̂_k + t − m_k‖², in closed form (Umeyama, PAMI 13(4) 1991, eqs 39 to 43)."""
    from_, to = points - points.mean(axis=0), truth - truth.mean(axis=0)
    left, sizes, right = np.linalg.svd(to.T @ from_)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left) * np.linalg.det(right))])
    scale = float(sizes @ signs / np.sum(from_ * from_))
    return np.asarray(scale * from_ @ ((left * signs) @ right).T + truth.mean(axis=0))
