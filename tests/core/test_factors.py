"""The factors of joining against dense algebra and numeric Jacobians."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from submaps.atlas.cholesky import cholesky, information
from submaps.atlas.coordinates import left_inverse, left_inverse_slope
from submaps.atlas.factors import factor, normal_equations, residual, rows_of
from submaps.errors import NumericalError
from submaps.geometry.space import Space
from tests.core.atlases import both_filters, both_spaces, chain, inside, moved, outside, relative, submap
from tests.core.filters import after, left_jacobian, minus, turned
from tests.core.support import jacobian, random_covariance

Floats = NDArray[np.float64]


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


def estimates(space: Space, seed: int, turn: float) -> tuple[Floats, Floats, Floats, Floats]:
    """An estimate, and a frame, end and landmarks whose rotation disagrees with it by ``turn``."""
    rng = np.random.default_rng(seed)
    d, p = space.dim, space.pose
    estimate = rng.normal(size=p + 3 * d) * 5.0
    estimate[d:p] = rng.uniform(-2.0, 2.0, size=space.rot) / np.sqrt(space.rot)
    axis = rng.normal(size=space.rot)
    frame = np.concatenate([rng.normal(size=d) * 10.0, rng.uniform(-3.0, 3.0, size=space.rot) / np.sqrt(space.rot)])
    off = turned(space, axis / np.linalg.norm(axis) * turn, estimate[d:p])
    end = after(space, frame, np.concatenate([estimate[:d] + rng.normal(size=d), off]))
    points = frame[:d] + rng.normal(size=(3, d)) * 8.0
    return estimate, frame, end, points


def evaluate(
    space: Space, invariant: bool, estimate: Floats, frame: Floats, end: Floats, points: Floats
) -> tuple[Floats, Floats]:
    d = estimate.shape[0]
    xi, J = np.full(d, np.nan), np.full((d, 2 * space.pose + space.dim), np.nan)
    residual(space.key, invariant, estimate, frame, end, points, xi, J)
    return xi, J


def whole_jacobian(space: Space, J: Floats) -> Floats:
    """The Jacobian with a column for every landmark, from the compact one."""
    d, p = J.shape[0], space.pose
    whole = np.zeros((d, d + p))
    whole[:, : 2 * p] = J[:, : 2 * p]
    for i in range(p, d, space.dim):
        whole[i : i + space.dim, i + p : i + p + space.dim] = J[i : i + space.dim, 2 * p :]
    return whole


@both_spaces
@both_filters
@pytest.mark.parametrize("turn", [0.0, 1e-9, 0.01, 0.25, 0.29, 0.31, -0.7, 2.0, -3.0])
def test_residual_and_its_jacobian(space: Space, invariant: bool, turn: float) -> None:
    estimate, frame, end, points = estimates(space, 3, turn)
    xi, J = evaluate(space, invariant, estimate, frame, end, points)
    local = np.concatenate([relative(space, frame, end), inside(space, frame, points).ravel()])
    assert np.linalg.norm(xi[space.dim : space.pose]) == pytest.approx(abs(turn), abs=1e-12)
    assert np.allclose(xi, minus(space, local, estimate, invariant), rtol=1e-10, atol=1e-10)

    def of(e: Floats) -> Floats:
        p = space.pose
        moved_to = moved(space, frame, e[:p]), moved(space, end, e[p : 2 * p])
        return evaluate(space, invariant, estimate, *moved_to, points + e[2 * p :].reshape(points.shape))[0]

    numeric = jacobian(of, np.zeros(2 * space.pose + points.size), 3e-3)
    assert np.allclose(whole_jacobian(space, J), numeric, rtol=1e-8, atol=1e-8)


@both_spaces
@both_filters
def test_a_prediction_equal_to_the_estimate_leaves_nothing(space: Space, invariant: bool) -> None:
    estimate, frame, _, _ = estimates(space, 4, 0.0)
    end = after(space, frame, estimate[: space.pose])
    points = outside(space, frame, estimate[space.pose :].reshape(-1, space.dim))
    xi, _ = evaluate(space, invariant, estimate, frame, end, points)
    assert np.abs(xi).max() < 2e-13


@both_spaces
@both_filters
def test_normal_equations(space: Space, invariant: bool) -> None:
    estimate, frame, end, points = estimates(space, 5, 0.2)
    xi, J = evaluate(space, invariant, estimate, frame, end, points)
    d, size = estimate.shape[0], estimate.shape[0] + space.pose
    W = np.linalg.inv(random_covariance(np.random.default_rng(5), d, 0.3))
    W = 0.5 * (W + W.T)
    H, g = np.full((size, size), np.nan), np.full(size, np.nan)
    cost = normal_equations(space.key, W, xi, J, H, g)
    whole = whole_jacobian(space, J)
    assert cost == pytest.approx(xi @ W @ xi, rel=1e-12)
    assert np.allclose(g, whole.T @ W @ xi, rtol=1e-11, atol=1e-9)
    lower = np.tril_indices(size)
    assert np.allclose(H[lower], (whole.T @ W @ whole)[lower], rtol=1e-11, atol=1e-9)


@both_spaces
@pytest.mark.parametrize("turn", [0.0, 1e-7, 0.29, 0.31, 1.0, 3.0])
def test_the_slope_of_the_inverse_left_jacobian(space: Space, turn: float) -> None:
    rng = np.random.default_rng(6)
    v, phi = rng.normal(size=space.dim), rng.normal(size=space.rot)
    phi *= turn / np.linalg.norm(phi)
    _, series = left_inverse(tuple(phi.tolist()))
    found = np.array(left_inverse_slope(tuple(phi.tolist()), series, tuple(v.tolist()))).T
    numeric = jacobian(lambda e: np.asarray(np.linalg.solve(left_jacobian(space, e), v)), phi, 3e-3)
    assert np.allclose(found, numeric, rtol=1e-8, atol=1e-9)


@both_spaces
def test_landmarks_left_out_are_marginalised(space: Space) -> None:
    s = chain([[0, 1, 2, 3]], space)[0]
    rows = rows_of(s, [3, 1])
    expected = {2: [0, 1, 2, 9, 10, 5, 6], 3: [0, 1, 2, 3, 4, 5, 15, 16, 17, 9, 10, 11]}
    assert rows.tolist() == expected[space.dim]
    estimate, W = factor(s, rows)
    assert np.array_equal(estimate, s.mean[rows])
    assert np.allclose(np.linalg.inv(W), s.covariance()[np.ix_(rows, rows)], rtol=1e-9, atol=1e-14)
    assert np.array_equal(s.covariance(rows), s.covariance()[np.ix_(rows, rows)])
