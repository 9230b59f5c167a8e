"""Does the estimate say how wrong it is? NEES at fixed seeds, in the world that tells filters apart."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.consistency import study
from submaps.consistency import average_bounds, chi_square_bound, nees

RUNS = 50
BAND = (0.79, 1.24)  # 95 %, of the mean NEES of a pose per degree of freedom over so many runs


@pytest.fixture(scope="module")
def circle_world() -> dict[str, dict[str, float]]:
    """The three ways of estimating, over the same runs."""
    return study(RUNS, seed=3)


def test_joined_sub_maps_are_consistent(circle_world: dict[str, dict[str, float]]) -> None:
    low, high = average_bounds(0.99, 3, RUNS)
    assert low <= circle_world["sub-maps joined"]["nees"] <= high
    assert circle_world["sub-maps joined"]["submaps"] > 20


def test_the_right_invariant_filter_is_consistent(circle_world: dict[str, dict[str, float]]) -> None:
    assert average_bounds(0.95, 3, RUNS) == pytest.approx(BAND, abs=0.005)
    assert BAND[0] <= circle_world["one right-invariant map"]["nees"] <= BAND[1]


def test_joining_loses_nothing(circle_world: dict[str, dict[str, float]]) -> None:
    joined, single = circle_world["sub-maps joined"], circle_world["one right-invariant map"]
    assert joined["rmse_m"] == pytest.approx(single["rmse_m"], rel=0.05)
    assert joined["nees"] == pytest.approx(single["nees"], rel=0.1)


def test_the_textbook_filter_is_not_consistent(circle_world: dict[str, dict[str, float]]) -> None:
    assert circle_world["one standard EKF"]["nees"] > 2.0


def test_nees_of_samples_is_chi_square() -> None:
    rng = np.random.default_rng(5)
    root = rng.normal(size=(3, 3))
    samples = rng.normal(size=(4000, 3)) @ root.T
    values = np.array([nees(e, root @ root.T) for e in samples])
    low, high = average_bounds(0.999, 3, 4000)
    assert low < values.mean() / 3.0 < high
    assert np.mean(values < chi_square_bound(0.9, 3)) == pytest.approx(0.9, abs=0.02)
