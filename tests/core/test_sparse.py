"""Sparse normal equations against dense ones, on random factor graphs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from submaps.atlas.sparse import Factorisation, Pattern
from submaps.errors import NumericalError
from tests.core.support import random_covariance

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
settings.register_profile("laws", derandomize=True, deadline=None, max_examples=100)


def graph(seed: int) -> tuple[Ints, list[Ints]]:
    """Widths of the variables, and factors over them: a fixed start, a chain, and random ties."""
    rng = np.random.default_rng(seed)
    poses, points = int(rng.integers(1, 12)), int(rng.integers(0, 15))
    widths = np.array([3] * poses + [2] * points, dtype=np.int64)
    factors = []
    for f in range(poses):
        seen = poses + rng.permutation(points)[: rng.integers(0, 5)] if points else np.empty(0, dtype=np.int64)
        factors.append(np.array([f - 1, f, *seen], dtype=np.int64))
    unseen = set(range(poses, poses + points)) - {int(v) for f in factors for v in f}
    factors.append(np.array([poses - 1, *rng.permutation(sorted(unseen))], dtype=np.int64))
    return widths, factors


def build(seed: int) -> tuple[Pattern, list[Ints], Floats, Floats, Floats, Floats]:
    """The pattern and its filled entries, beside the same normal equations dense."""
    rng = np.random.default_rng(1000 + seed)
    widths, factors = graph(seed)
    pattern = Pattern(widths, np.cumsum([0, *(f.shape[0] for f in factors)]), np.concatenate(factors))
    data, gradient = np.zeros(pattern.indices.shape[0]), np.zeros(pattern.size)
    H, g = np.zeros((pattern.size, pattern.size)), np.zeros(pattern.size)
    for f in factors:
        entries = [e for v in f if v >= 0 for e in range(pattern.start[v], pattern.start[v + 1])]
        fixed = 3 * int(np.sum(f < 0))
        block, slope = random_covariance(rng, len(entries) + fixed), rng.normal(size=len(entries) + fixed)
        lower_only = np.tril(block) + np.triu(np.full_like(block, np.nan), 1)
        pattern.add(f, lower_only, slope, data, gradient)
        H[np.ix_(entries, entries)] += block[fixed:, fixed:]
        g[entries] += slope[fixed:]
    return pattern, factors, data, gradient, H, g


@settings(settings.get_profile("laws"))
@given(st.integers(0, 10_000))
def test_random_graphs(seed: int) -> None:
    pattern, factors, data, gradient, H, g = build(seed)
    assert np.allclose(pattern.matrix(data).toarray(), np.triu(H), rtol=1e-13, atol=1e-14)
    assert np.allclose(gradient, g, rtol=1e-13, atol=1e-14)
    assert np.allclose(data[pattern.diagonal], np.diag(H), rtol=1e-13)
    factorisation = Factorisation(pattern, data)
    assert np.allclose(factorisation.solve(gradient), np.linalg.solve(H, g), rtol=1e-8, atol=1e-9)
    inverse, subset = np.linalg.inv(H), factorisation.inverse_subset()
    for f in factors:
        own = f[f >= 0][::-1].copy()
        entries = [e for v in own for e in range(pattern.start[v], pattern.start[v + 1])]
        joint = subset.joint(own)
        assert np.allclose(joint, inverse[np.ix_(entries, entries)], rtol=1e-8, atol=1e-9)
        assert np.array_equal(joint, joint.T)


def test_factorising_again_on_the_same_pattern() -> None:
    pattern, _, data, gradient, H, g = build(7)
    factorisation = Factorisation(pattern, data)
    factorisation.update(3.0 * data)
    assert np.allclose(factorisation.solve(gradient), np.linalg.solve(3.0 * H, g), rtol=1e-9, atol=1e-10)
    inverse = np.linalg.inv(3.0 * H)
    assert np.allclose(factorisation.inverse_subset().joint(np.array([0])), inverse[:3, :3], rtol=1e-9)


def test_many_variables_outgrow_the_first_guess() -> None:
    """One factor over forty variables: more blocks than four a variable."""
    widths = np.full(40, 2, dtype=np.int64)
    pattern = Pattern(widths, np.array([0, 40]), np.arange(40))
    assert pattern.indices.shape[0] == 80 * 81 // 2
    block = random_covariance(np.random.default_rng(0), 80)
    data, gradient = np.zeros(pattern.indices.shape[0]), np.zeros(80)
    pattern.add(np.arange(40), block, np.zeros(80), data, gradient)
    joint = Factorisation(pattern, data).inverse_subset().joint(np.arange(40))
    assert np.allclose(joint, np.linalg.inv(block), atol=1e-9)


@pytest.mark.parametrize("worst", [-1.0, 0.0, np.nan])
def test_a_bad_pivot_is_an_error(worst: float) -> None:
    pattern, _, data, *_ = build(7)
    bad = data.copy()
    bad[pattern.diagonal[2]] = worst * abs(bad[pattern.diagonal[2]])
    with pytest.raises(NumericalError):
        Factorisation(pattern, bad)
    factorisation = Factorisation(pattern, data)
    with pytest.raises(NumericalError):
        factorisation.update(bad)
