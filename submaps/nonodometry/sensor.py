"""What a view measures of each point, as a function of the point in the body frame.

Arrays have coordinates before points, y (..., 3, n): the last axis, which arithmetic runs along, is
the long one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class Sensor(Protocol):
    """An observation model: h(y), dh/dy and where h is defined, of points y (..., 3, n) in the body frame."""

    @property
    def sigma(self) -> Floats:
        """Standard deviations (d,) of what is measured of one point."""
        ...

    def observe(self, y: Floats) -> Floats:
        """h(y) (..., d, n)."""
        ...

    def jacobian(self, y: Floats) -> Floats:
        """dh/dy (..., d, 3, n)."""
        ...

    def sees(self, y: Floats) -> NDArray[np.bool_]:
        """Whether a point there can be measured (..., n)."""
        ...


@dataclass(frozen=True)
class Camera:
    """Monocular projection: z = c + f (y₁/y₃, y₂/y₃) of y = (right, down, forward).

    ``focal`` (f₁, f₂), ``centre`` (c₁, c₂) and ``noise`` (σ of either coordinate) are in pixels; with
    the defaults z is normalised and ``noise`` a tangent.
    """

    noise: float
    focal: tuple[float, float] = (1.0, 1.0)
    centre: tuple[float, float] = (0.0, 0.0)

    @property
    def sigma(self) -> Floats:
        """Standard deviations (2,)."""
        return np.full(2, self.noise)

    def observe(self, y: Floats) -> Floats:
        """z (..., 2, n)."""
        z = np.empty((*y.shape[:-2], 2, y.shape[-1]))
        for k in (0, 1):
            z[..., k, :] = self.centre[k] + self.focal[k] * (y[..., k, :] / y[..., 2, :])
        return z

    def jacobian(self, y: Floats) -> Floats:
        """dz/dy (..., 2, 3, n) = f/y₃ [I, −(y₁, y₂)ᵀ/y₃]."""
        found = np.zeros((*y.shape[:-2], 2, 3, y.shape[-1]))
        near = 1.0 / y[..., 2, :]
        for k in (0, 1):
            found[..., k, k, :] = self.focal[k] * near
            found[..., k, 2, :] = -found[..., k, k, :] * y[..., k, :] * near
        return found

    def sees(self, y: Floats) -> NDArray[np.bool_]:
        """Whether the point lies before the camera."""
        return np.asarray(y[..., 2, :] > 0.0)
