"""The factors of joining against dense algebra and numeric Jacobians."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from submaps.atlas.factors import cholesky, factor, information, normal_equations, residual, rows_of
from submaps.errors import NumericalError
from tests.core.support import after, chain, jacobian, minus, random_covariance, relative, submap

Floats = NDArray[np.float64]
both_filters = pytest.mark.parametrize("invariant", [True, False], ids=["invariant", "standard"])


@pytest.mark.parametrize("size", [1, 3, 8, 23])
def test_cholesky_and_information(size: int) -> None:
    P = random_covariance(np.random.default_rng(size), size)
    L = P.copy()
    assert cholesky(L)
    assert np.allclose(np.tril(L), np.linalg.cholesky(P), rtol=1e-12)
    out = np.empty_like(P)
    assert information(P.copy(), out)
    assert np.allclose(out, np.linalg.inv(P), rtol=1e-10, atol=1e-12)
    assert np.array_equal(out, out.T)


@pytest.mark.parametrize("worst", [0.0, -1e-3, np.nan, np.inf])
def test_what_is_not_positive_definite_is_refused(worst: float) -> None:
    P = random_covariance(np.random.default_rng(0), 6)
    P[4, 4] = worst
    assert not information(P.copy(), np.empty_like(P))
    with pytest.raises(NumericalError, match="submap 7"):
        factor(submap(7, [0], np.zeros(5), P[:5, :5]), np.arange(5))


def estimates(seed: int, turn: float) -> tuple[Floats, Floats, Floats, Floats]:
    """An estimate, and a frame, end and landmarks whose heading disagrees with it by ``turn``."""
    rng = np.random.default_rng(seed)
    estimate = rng.normal(size=9) * 5.0
    estimate[2] = rng.uniform(-2.0, 2.0)
    frame = np.array([*rng.normal(size=2) * 10.0, rng.uniform(-3.0, 3.0)])
    end = after(frame, np.array([*(estimate[:2] + rng.normal(size=2)), estimate[2] + turn]))
    points = frame[:2] + rng.normal(size=(3, 2)) * 8.0
    return estimate, frame, end, points


def evaluate(invariant: bool, estimate: Floats, frame: Floats, end: Floats, points: Floats) -> tuple[Floats, Floats]:
    xi, J = np.empty(estimate.shape[0]), np.empty((estimate.shape[0], 8))
    residual(invariant, estimate, frame, end, points, xi, J)
    return xi, J


def whole_jacobian(J: Floats) -> Floats:
    """The Jacobian with a column for every landmark, from the compact one."""
    d = J.shape[0]
    whole = np.zeros((d, d + 3))
    whole[:, :6] = J[:, :6]
    for i in range(3, d, 2):
        whole[i : i + 2, i + 3 : i + 5] = J[i : i + 2, 6:]
    return whole


@both_filters
@pytest.mark.parametrize("turn", [0.0, 1e-9, 0.01, 0.25, 0.29, 0.31, -0.7, 2.0, -3.0])
def test_residual_and_its_jacobian(invariant: bool, turn: float) -> None:
    estimate, frame, end, points = estimates(3, turn)
    xi, J = evaluate(invariant, estimate, frame, end, points)
    local = np.concatenate([relative(frame, end), *(relative(frame, np.array([*p, 0.0]))[:2] for p in points)])
    expected = minus(local, estimate, invariant)
    assert xi[2] == pytest.approx(turn, abs=1e-12)
    assert np.allclose(xi, expected, rtol=1e-10, atol=1e-10)

    def of(v: Floats) -> Floats:
        return evaluate(invariant, estimate, v[:3].copy(), v[3:6].copy(), v[6:].reshape(-1, 2).copy())[0]

    numeric = jacobian(of, np.concatenate([frame, end, points.ravel()]), 3e-3)
    assert np.allclose(whole_jacobian(J), numeric, rtol=1e-8, atol=1e-8)


@both_filters
def test_a_prediction_equal_to_the_estimate_leaves_nothing(invariant: bool) -> None:
    estimate, frame, _, _ = estimates(4, 0.0)
    end = after(frame, estimate[:3])
    points = np.array([after(frame, np.array([*p, 0.0]))[:2] for p in estimate[3:].reshape(-1, 2)])
    xi, _ = evaluate(invariant, estimate, frame, end, points)
    assert np.abs(xi).max() < 1e-13


@both_filters
def test_normal_equations(invariant: bool) -> None:
    estimate, frame, end, points = estimates(5, 0.2)
    xi, J = evaluate(invariant, estimate, frame, end, points)
    W = np.linalg.inv(random_covariance(np.random.default_rng(5), 9, 0.3))
    W = 0.5 * (W + W.T)
    H, g = np.full((12, 12), np.nan), np.full(12, np.nan)
    cost = normal_equations(W, xi, J, H, g)
    whole = whole_jacobian(J)
    assert cost == pytest.approx(xi @ W @ xi, rel=1e-12)
    assert np.allclose(g, whole.T @ W @ xi, rtol=1e-11, atol=1e-9)
    lower = np.tril_indices(12)
    assert np.allclose(H[lower], (whole.T @ W @ whole)[lower], rtol=1e-11, atol=1e-9)


def test_landmarks_left_out_are_marginalised() -> None:
    s = chain([[0, 1, 2, 3]])[0]
    rows = rows_of(s, [3, 1])
    assert rows.tolist() == [0, 1, 2, 9, 10, 5, 6]
    estimate, W = factor(s, rows)
    assert np.array_equal(estimate, s.mean[rows])
    assert np.allclose(np.linalg.inv(W), s.covariance()[np.ix_(rows, rows)], rtol=1e-9, atol=1e-14)
    assert np.array_equal(s.covariance(rows), s.covariance()[np.ix_(rows, rows)])
