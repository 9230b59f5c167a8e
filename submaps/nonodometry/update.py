"""The main path: one view, from the belief before it to the belief after."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from submaps.errors import MeasurementError
from submaps.filtering.unscented import cholesky
from submaps.nonodometry.belief import Belief, Status, Update, view_at
from submaps.nonodometry.likelihood import maximum_likelihood
from submaps.nonodometry.moments import Filter, Moments
from submaps.nonodometry.poses import Poses
from submaps.nonodometry.sensor import Sensor

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def update(
    filter_: Filter, sensor: Sensor, belief: Belief, z: Floats, guess: Poses, seen: Ints | None = None
) -> Update:
    """One view z (k, d) of the points ``seen`` (k,) (all, in order, if None), its pose looked for from ``guess``.

    The guess is where the search starts, such as the pose of the view before, and no information.
    Raises ``MeasurementError`` where z does not fit the points; everything else is the ``status``.
    """
    index = np.arange(len(belief.points)) if seen is None else seen
    if z.shape != (len(index), len(sensor.sigma)) or not np.all(np.isfinite(z)):
        raise MeasurementError(f"got z of shape {z.shape}, expected finite ({len(index)}, {len(sensor.sigma)})")
    fit = maximum_likelihood(sensor, belief.points[np.newaxis, index], z, guess.repeat(1))
    view = view_at(sensor, belief, fit.poses.take(0), z, index) if fit.found[0] else None
    if view is None:
        return Update(belief, Status.no_pose)
    moments = filter_(sensor, belief, view)
    if isinstance(moments, Status):
        return Update(belief, moments)
    return _condition(belief, moments)


def _condition(belief: Belief, moments: Moments) -> Update:
    """K = C S⁻¹, mean + K (z − ẑ), P − K S Kᵀ (eqs 17 to 19), and the marginal of the map (eqs 13, 14)."""
    factor = cholesky(moments.spread)
    if factor is None:
        return Update(belief, Status.not_positive)
    whitened = solve_triangular(
        factor, np.column_stack([moments.with_measured.T, moments.innovation]), lower=True, check_finite=False
    )
    V, step = whitened[:, :-1], whitened[:, :-1].T @ whitened[:, -1]  # VᵀV = K S Kᵀ
    P = moments.covariance - V.T @ V
    P = 0.5 * (P + P.T)
    if cholesky(P) is None:
        return Update(belief, Status.not_positive)
    after = Belief(belief.points + step[6:].reshape(-1, 3), P[6:, 6:])
    return Update(after, Status.done, moments.pose.retract(step[:6]), P)
