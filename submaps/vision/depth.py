"""Depth of a point seen by two cameras whose rotation and translation are known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_PARALLEL = 1e-12  # of rays: the square of a denominator, relative to the terms that make it


def homogeneous(y: Floats) -> Floats:
    """(y₁, y₂, 1) (..., 3) of image points (..., 2); the lecture's X = y x₃ means these."""
    return np.concatenate([y, np.ones((*y.shape[:-1], 1))], axis=-1)


def depth_by_component(rotation: Floats, translation: Floats, y: Floats, y_two: Floats, component: int = 0) -> Floats:
    """x₃ = ((y'₁ r₃ − r₁)ᵀ t) / ((y'₁ r₃ − r₁)ᵀ y), the lecture's closed form, of image points (..., 2).

    rᵢ are the rows of R (3, 3); ``component`` 1 takes y'₂ and r₂ in place of y'₁ and r₁. Where the
    denominator is 0 this component says nothing of the depth (the first, if camera two stands straight
    above or below camera one and is not rotated), and the result is NaN.
    """
    numerator, denominator, scale = _ratio(rotation, translation, y, y_two, component)
    known = np.abs(denominator) > np.sqrt(_PARALLEL) * scale
    return np.where(known, numerator / np.where(known, denominator, 1.0), np.nan)


def depth(rotation: Floats, translation: Floats, y: Floats, y_two: Floats) -> Floats:
    """x₃ by both components together, in the least-squares sense: Σ aᵢ bᵢ / Σ bᵢ².

    aᵢ and bᵢ are numerator and denominator of ``depth_by_component``, so a component that says nothing
    has no weight. NaN where both denominators are 0: the rays are parallel, or the point lies on the
    line through both cameras.
    """
    a, b, scale = (
        np.stack(parts)
        for parts in zip(*(_ratio(rotation, translation, y, y_two, k) for k in (0, 1)), strict=True)
    )  # fmt: skip
    squared = np.sum(b * b, axis=0)
    known = squared > _PARALLEL * np.max(scale, axis=0) ** 2
    return np.where(known, np.sum(a * b, axis=0) / np.where(known, squared, 1.0), np.nan)


def reconstruct(rotation: Floats, translation: Floats, y: Floats, y_two: Floats) -> Floats:
    """X = (y₁, y₂, 1) x₃ (..., 3) in camera one's frame; it scales as the translation does."""
    return np.asarray(homogeneous(y) * depth(rotation, translation, y, y_two)[..., np.newaxis])


def _ratio(
    rotation: Floats, translation: Floats, y: Floats, y_two: Floats, component: int
) -> tuple[Floats, Floats, Floats]:
    normal = y_two[..., component, np.newaxis] * rotation[2] - rotation[component]
    ray = homogeneous(y)
    scale = np.linalg.norm(normal, axis=-1) * np.linalg.norm(ray, axis=-1)
    return normal @ translation, np.sum(normal * ray, axis=-1), scale
