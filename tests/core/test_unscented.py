"""The unscented transform and filter: exact where things are linear or quadratic, on any retraction."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from submaps.errors import ConfigError
from submaps.filtering.unscented import Scaling, offsets, predict, update

Floats = NDArray[np.float64]

SCALINGS = [Scaling(1.0, 2.0, 0.0), Scaling(0.1, 2.0, 0.0), Scaling(1e-3, 2.0, 0.0), Scaling(1.0, 0.0, 3.0)]


def add(x: Floats, xi: Floats) -> Floats:
    return x + xi


def subtract(states: Floats, x: Floats) -> Floats:
    return states - x


def spread(rng: np.random.Generator, size: int) -> Floats:
    factor = rng.normal(size=(size, size))
    return factor @ factor.T + 0.1 * np.eye(size)


@pytest.mark.parametrize("scaling", SCALINGS)
@pytest.mark.parametrize("dimension", [1, 3, 96])
def test_weights_sum_to_one_and_sigma_points_carry_the_covariance(scaling: Scaling, dimension: int) -> None:
    weight = scaling.weights(dimension)
    assert weight.mean.sum() == pytest.approx(1.0, abs=1e-9)
    covariance = spread(np.random.default_rng(1), dimension)
    xi = offsets(covariance, weight.spread)
    assert xi is not None
    assert xi.shape == (2 * dimension + 1, dimension)
    assert np.allclose((xi.T * weight.mean) @ xi, covariance, rtol=1e-10)
    assert np.allclose(weight.mean @ xi, 0.0, atol=1e-12)


@pytest.mark.parametrize("scaling", SCALINGS)
def test_on_a_linear_world_it_is_the_kalman_filter(scaling: Scaling) -> None:
    rng = np.random.default_rng(2)
    F, H = rng.normal(size=(5, 5)), rng.normal(size=(3, 5))
    P, Q, R = spread(rng, 5), spread(rng, 5), spread(rng, 3)
    x, z = rng.normal(size=5), rng.normal(size=3)
    most = max(1e-10, 1e-14 / scaling.alpha**2)  # sigma points that lie so close differ by few digits
    predicted = predict(x, P, lambda s: s @ F.T, Q, add, subtract, scaling)
    assert np.allclose(predicted.state, F @ x, rtol=0, atol=most)
    assert np.allclose(predicted.covariance, F @ P @ F.T + Q, rtol=0, atol=most)
    updated = update(x, P, z, lambda s: s @ H.T, R, add, scaling)
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    assert np.allclose(updated.innovation_covariance, S, rtol=0, atol=most)
    assert np.allclose(updated.state, x + K @ (z - H @ x), rtol=0, atol=most)
    assert np.allclose(updated.covariance, P - K @ S @ K.T, rtol=0, atol=most)


def test_the_mean_of_a_quadratic_is_exact() -> None:
    """E[xᵀAx] = x̂ᵀAx̂ + tr(AP), which a linearised prediction misses."""
    rng = np.random.default_rng(3)
    A, P, x = spread(rng, 4), spread(rng, 4), rng.normal(size=4)

    def grow(s: Floats) -> Floats:
        return np.asarray(s + np.einsum("...i,ij,...j->...", s, A, s)[..., np.newaxis])

    found = predict(x, P, grow, np.zeros((4, 4)), add, subtract, Scaling(1.0))
    assert np.allclose(found.state, x + x @ A @ x + np.trace(A @ P), rtol=1e-12)


def turn(x: Floats, xi: Floats) -> Floats:
    return (x + xi + np.pi) % (2.0 * np.pi) - np.pi


def between(states: Floats, x: Floats) -> Floats:
    return (states - x + np.pi) % (2.0 * np.pi) - np.pi


def test_a_state_on_a_circle_does_not_notice_where_angles_wrap() -> None:
    """The same problem turned by half a circle, across ±π, has the same answer, turned."""
    P, R, scaling = np.diag([0.04, 0.09]), np.diag([0.01, 0.02]), Scaling(1.0)
    F = np.array([[1.0, 0.5], [0.0, 1.0]])
    answers = []
    for start in (np.array([0.1, -0.2]), np.array([np.pi - 0.1, np.pi - 0.1])):
        shift = start - (0.1, -0.2)

        def motion(s: Floats, shift: Floats = shift) -> Floats:
            return turn(between(s, shift) @ F.T, shift)

        moved = predict(turn(start, np.zeros(2)), P, motion, R, turn, between, scaling)
        z = turn(shift, np.array([0.3, -0.1]))
        seen = update(moved.state, moved.covariance, z, lambda s: s, R, turn, scaling, difference=between)
        answers.append((between(seen.state, shift), seen.covariance, seen.innovation))
    for one, other in zip(*answers, strict=True):
        assert np.allclose(one, other, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("alpha", [1.0, 0.1, 1e-3])
def test_with_beta_not_below_alpha_squared_no_nonlinearity_costs_definiteness(seed: int, alpha: float) -> None:
    rng = np.random.default_rng(seed)
    A, b = 3.0 * rng.normal(size=(4, 6)), rng.normal(size=4)
    bend: Callable[[Floats], Floats] = lambda s: np.sin(s @ A.T + b) + (s @ A.T) ** 2  # noqa: E731
    found = update(rng.normal(size=6), spread(rng, 6), rng.normal(size=4), bend, 1e-3 * np.eye(4), add, Scaling(alpha))
    assert found.positive
    assert np.linalg.eigvalsh(found.covariance)[0] > 0.0
    assert np.linalg.eigvalsh(found.innovation_covariance)[0] > 0.0


def test_a_covariance_that_is_none_is_told_and_changes_nothing() -> None:
    x, P = np.ones(2), np.array([[1.0, 2.0], [2.0, 1.0]])
    moved = predict(x, P, lambda s: s, np.eye(2), add, subtract, Scaling())
    seen = update(x, P, np.zeros(2), lambda s: s, np.eye(2), add, Scaling())
    for found in (moved, seen):
        assert not found.positive
        assert found.state is x
        assert found.covariance is P


@pytest.mark.parametrize("scaling", [Scaling(alpha=0.0), Scaling(kappa=-3.0), Scaling(alpha=float("nan"))])
def test_a_scaling_without_spread_is_refused(scaling: Scaling) -> None:
    with pytest.raises(ConfigError, match="above 0"):
        scaling.weights(3)
