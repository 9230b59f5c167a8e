"""A pose for each sigma point of the map: the paper's three variants (eqs 22, 24, 25).

Each takes the sigma points of what is seen (s, k, 3) and their tangents (s, 3n), and gives s poses, or
None where one was not found.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from submaps.nonodometry import likelihood
from submaps.nonodometry.belief import View
from submaps.nonodometry.poses import Poses
from submaps.nonodometry.sensor import Sensor

Floats = NDArray[np.float64]

SigmaPoses = Callable[[Sensor, View, Floats, Floats], Poses | None]


def constant(sensor: Sensor, view: View, points: Floats, xi: Floats) -> Poses:
    """χ^x = x̂ (eq. 22): the pose keeps still whatever the map does."""
    return view.pose.repeat(len(xi))


def linear(sensor: Sensor, view: View, points: Floats, xi: Floats) -> Poses:
    """χ^x = x̂ − (HₓᵀR⁻¹Hₓ)⁻¹ HₓᵀR⁻¹H_m (χ^m − m̂) (eq. 24), retracted."""
    return view.pose.retract(-xi @ view.correction.T)


def maximum_likelihood(sensor: Sensor, view: View, points: Floats, xi: Floats) -> Poses | None:
    """χ^x = argmax ℓ(x | z, χ^m) (eq. 25), from the linear correction on, all sigma points at once."""
    fit = likelihood.maximum_likelihood(sensor, points, view.z, linear(sensor, view, points, xi))
    return fit.poses if np.all(fit.found) else None
