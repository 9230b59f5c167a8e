"""A vehicle that stands still must not learn its heading: the lecture's phantom update, its form and its limits."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from submaps.reference.moments import Exact, Rule, first_order, second_order
from submaps.reference.phantom import Reading, Still, heading_gain, heading_row, measured_gain, surroundings

SIGMA = math.radians(5.0)
FIRST = Reading(8.0, 0.7, 0.1, math.radians(1.0), SIGMA)
STILL = Still(surroundings(np.random.default_rng(1)), SIGMA, (0.1, math.radians(1.0)))


def test_ten_thousand_scans_tell_the_right_invariant_filter_nothing_of_its_heading() -> None:
    heading, variance = STILL.watch(10_000, np.random.default_rng(2), invariant=True)
    assert np.abs(np.sqrt(variance) / SIGMA - 1.0).max() < 1e-6
    assert np.abs(heading).max() < 1e-12


@pytest.mark.parametrize("noise", [0.1, 1.0, 10.0])
def test_they_tell_the_standard_filter_a_heading_that_nobody_measured(noise: float) -> None:
    louder = replace(STILL, sigma=(noise * STILL.sigma[0], noise * STILL.sigma[1]))
    heading, variance = louder.watch(10_000, np.random.default_rng(2), invariant=False)
    assert math.sqrt(variance[-1]) < 0.5 * SIGMA
    assert np.abs(heading).max() > 0.05 * SIGMA


@pytest.mark.parametrize("rule", [second_order, Exact(7)], ids=["second order", "exact"])
def test_better_moments_do_not_help(rule: Rule) -> None:
    _, variance = STILL.watch_by_moments(100, np.random.default_rng(3), rule)
    assert math.sqrt(variance[-1]) < 0.5 * SIGMA


def test_the_moment_filter_fails_as_the_compiled_one_does() -> None:
    (heading, variance), (other, same) = (
        STILL.watch(20, np.random.default_rng(4), invariant=False),
        STILL.watch_by_moments(20, np.random.default_rng(4), first_order),
    )
    assert np.allclose(heading, other, atol=1e-10)
    assert np.allclose(variance, same, rtol=1e-8)


@pytest.mark.parametrize("turn", np.linspace(-0.3, 0.3, 7))
@pytest.mark.parametrize("range_", [7.0, 8.0, 9.5])
def test_the_gain_on_heading_has_the_closed_form(range_: float, turn: float) -> None:
    found = measured_gain(FIRST, range_, turn, invariant=False)
    assert found == pytest.approx(heading_gain(FIRST, range_, turn), rel=1e-8, abs=1e-12)
    assert np.array_equal(measured_gain(FIRST, range_, turn, invariant=True), [0.0, 0.0])


def test_it_vanishes_only_where_the_landmark_was_made() -> None:
    assert np.array_equal(heading_row(FIRST, FIRST.range, 0.0), [0.0, 0.0])
    assert measured_gain(FIRST, FIRST.range, 0.0, invariant=False) == pytest.approx([0.0, 0.0], abs=1e-12)
    for range_, turn in ((8.0, 0.01), (8.0, -0.01), (8.1, 0.0)):
        assert np.abs(heading_row(FIRST, range_, turn)).max() > 1e-5
