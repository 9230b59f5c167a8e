"""Observation models: what a sensor reads of a point in the body frame, and back.

A model is h(y), dh/dy and the inverse y = g(z) with its covariance; the pose enters through y = R^T (l - p)
alone, so that a model knows nothing of filters or errors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class Observation(Protocol):
    """A sensor: readings z (m,) of points y (d,) in the body frame."""

    def predict(self, y: Floats) -> tuple[Floats, Floats]:
        """h(y) (m,) and dh/dy (m, d)."""
        ...

    def shown(self, z: Floats, R: Floats) -> tuple[Floats, Floats]:
        """g(z) (d,) and its covariance (d, d): G R G^T, G = dg/dz, and the prior of what the reading leaves open."""
        ...

    def innovation(self, z: Floats, expected: Floats) -> Floats:
        """z - h, an angle's difference taken the short way."""
        ...


@dataclass(frozen=True)
class Point:
    """The point itself, in the body frame, in any dimension: z = y."""

    def predict(self, y: Floats) -> tuple[Floats, Floats]:
        """y and the identity."""
        return y, np.eye(y.shape[0])

    def shown(self, z: Floats, R: Floats) -> tuple[Floats, Floats]:
        """z and R."""
        return z, R

    def innovation(self, z: Floats, expected: Floats) -> Floats:
        """The difference."""
        return np.asarray(z - expected)


@dataclass(frozen=True)
class Sighting:
    """A reading z (m,) with covariance R (m, m) of the point that begins at entry ``slot`` of the state."""

    slot: int
    z: Floats
    R: Floats
    model: Observation


def inverted(sighting: Sighting) -> Sighting:
    """The reading turned into a point, y = g(z), with its covariance carried over.

    The lecture's further trick: the update that follows is that of a Cartesian reading, linear in
    the body frame; what is linearised is linearised at the reading instead of at the estimate.
    """
    y, covariance = sighting.model.shown(sighting.z, sighting.R)
    return replace(sighting, z=y, R=covariance, model=Point())
