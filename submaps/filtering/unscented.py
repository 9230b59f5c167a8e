"""The unscented Kalman filter on any state that can be moved by a tangent.

Equations 5 to 12 of Klečka, "Comparison of different approaches to adaptation of unscented Kalman
filter for non-odometry SLAM", 2018, after Wan & van der Merwe, AS-SPCC 2000, with a retraction in
place of addition (Brossard, Barrau, Bonnabel, "A code for unscented Kalman filtering on manifolds",
ICRA 2020). Corrected: λ = α²(L + κ) − L and W_k = 1/(2(L + λ)). As printed, λ = α²(L + κ) and
W_k = 1/(L + λ): then the weights sum to 1 + L/(L + λ), which at α = 0.1 and κ = 0 is 1.99, and the
sigma points carry twice the covariance.

With these, Σ W_k^(c) (χ − χ̄)(χ − χ̄)ᵀ jointly with h(χ) is a sum of squares plus (β − α²) times that
of the mean's displacement: it has no negative eigenvalue as long as β ≥ α².

A state is whatever ``retract`` and ``minus`` know: ``retract(x, xi)`` gives the state at the tangent xi
(L,) from x, and for tangents (k, L) states with a leading axis k; ``minus(states, x)`` gives tangents
back. For a vector these are addition and subtraction. Motions and observations are functions of one
state or of many alike.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from submaps.errors import ConfigError

Floats = NDArray[np.float64]
State = TypeVar("State")


@dataclass(frozen=True)
class Weights:
    """Of 2L + 1 sigma points: for a mean, for a covariance, and √(L + λ) that they are spread by."""

    mean: Floats
    covariance: Floats
    spread: float


@dataclass(frozen=True)
class Scaling:
    """The free parameters: sigma points lie at α√(L + κ) standard deviations; β = 2 suits a Gaussian."""

    alpha: float = 0.1
    beta: float = 2.0
    kappa: float = 0.0

    def weights(self, dimension: int) -> Weights:
        """W₀^(m) = λ/(L + λ), W₀^(c) = W₀^(m) + 1 − α² + β, W_k = 1/(2(L + λ)), λ = α²(L + κ) − L.

        Raises ``ConfigError`` where L + λ = α²(L + κ) is not above zero.
        """
        total = self.alpha**2 * (dimension + self.kappa)  # L + λ
        if not 0.0 < total < np.inf:
            raise ConfigError("scaling", self, f"alpha² ({dimension} + kappa) above 0 and finite")
        mean = np.full(2 * dimension + 1, 0.5 / total)
        mean[0] = (total - dimension) / total
        covariance = mean.copy()
        covariance[0] += 1.0 - self.alpha**2 + self.beta
        return Weights(mean, covariance, float(np.sqrt(total)))


@dataclass(frozen=True)
class Predicted(Generic[State]):
    """A state and its covariance (L, L) after a motion; ``positive`` is false where P had no Cholesky factor."""

    state: State
    covariance: Floats
    positive: bool


@dataclass(frozen=True)
class Updated(Generic[State]):
    """A state and its covariance (L, L) after a measurement, its innovation (d,) and that one's covariance.

    ``positive`` is false where P or S had no Cholesky factor: then the state is the one before.
    """

    state: State
    covariance: Floats
    innovation: Floats
    innovation_covariance: Floats
    positive: bool


def offsets(covariance: Floats, spread: float) -> Floats | None:
    """Tangents (2L + 1, L) of the sigma points: 0 and ± the columns of ``spread`` times a Cholesky factor (eq. 7).

    None where the covariance has no such factor.
    """
    factor = cholesky(covariance)
    if factor is None:
        return None
    columns = spread * factor.T
    return np.concatenate([np.zeros((1, len(columns))), columns, -columns])


def cholesky(matrix: Floats) -> Floats | None:
    """The lower Cholesky factor, or None where the matrix is not positive definite or not finite."""
    try:
        factor = np.asarray(np.linalg.cholesky(matrix), dtype=np.float64)
    except np.linalg.LinAlgError:
        return None
    return factor if np.all(np.isfinite(factor)) else None


def mean_of(
    states: State,
    start: State,
    weight: Floats,
    retract: Callable[[State, Floats], State],
    minus: Callable[[State, State], Floats],
    rounds: int = 5,
) -> State:
    """The x̄ at which Σ W_k (χ_k ⊖ x̄) = 0, from ``start``; for a vector the first round finds it."""
    mean = start
    for _ in range(rounds):
        error = minus(states, mean)
        # The weights sum to 1; W_0 may be minus a million and is not to meet what it cancels.
        step = error[0] + weight[1:] @ (error[1:] - error[0])
        mean = retract(mean, step)
        if float(np.abs(step).max()) <= 1e-9:
            break
    return mean


def predict(
    state: State,
    covariance: Floats,
    motion: Callable[[State], State],
    noise: Floats,
    retract: Callable[[State, Floats], State],
    minus: Callable[[State, State], Floats],
    scaling: Scaling,
) -> Predicted[State]:
    """Equations 5 and 6: the moments of ``motion`` of the sigma points, plus Q = ``noise`` (L, L)."""
    weight = scaling.weights(len(covariance))
    xi = offsets(covariance, weight.spread)
    if xi is None:
        return Predicted(state, covariance, positive=False)
    moved = motion(retract(state, xi))
    mean = mean_of(moved, motion(state), weight.mean, retract, minus)
    error = minus(moved, mean)
    return Predicted(mean, noise + (error.T * weight.covariance) @ error, positive=True)


def update(
    state: State,
    covariance: Floats,
    z: Floats,
    observe: Callable[[State], Floats],
    noise: Floats,
    retract: Callable[[State, Floats], State],
    scaling: Scaling,
    difference: Callable[[Floats, Floats], Floats] = np.subtract,
) -> Updated[State]:
    """Equations 8 to 12: a measurement z (d,) of ``observe`` (k states -> (k, d)), with R = ``noise`` (d, d).

    ``difference`` is that of two measurements, for those that are angles. The covariance stays in the
    tangent space at the state before: no transport to the new one.
    """
    weight = scaling.weights(len(covariance))
    xi = offsets(covariance, weight.spread)
    if xi is None:
        return Updated(state, covariance, np.full_like(z, np.nan), noise, positive=False)
    seen = observe(retract(state, xi))
    apart = difference(seen, seen[0])  # from the centre's, so that angles do not wrap in the mean
    bias = weight.mean @ apart
    deviation = apart - bias
    S = noise + (deviation.T * weight.covariance) @ deviation
    innovation = difference(z, seen[0]) - bias
    if cholesky(S) is None:
        return Updated(state, covariance, innovation, S, positive=False)
    K = np.linalg.solve(S, (deviation.T * weight.covariance) @ xi).T
    posterior = covariance - K @ S @ K.T
    return Updated(retract(state, K @ innovation), 0.5 * (posterior + posterior.T), innovation, S, positive=True)
