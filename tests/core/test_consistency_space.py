"""Does the estimate in space say how wrong it is? NEES at fixed seeds, in the world of Zhang et al."""

from __future__ import annotations

import pytest

from benchmarks.consistency3d import JOINED, SINGLE, STANDARD, Course, study
from submaps.consistency import average_bounds

RUNS = 10


@pytest.fixture(scope="module")
def tumbling() -> dict[str, Course]:
    """The three ways of estimating, over the same flights."""
    return study(RUNS, seed=2, steps=200)


@pytest.mark.parametrize("way", [JOINED, SINGLE])
def test_the_right_invariant_filter_is_consistent(tumbling: dict[str, Course], way: str) -> None:
    low, high = average_bounds(0.95, 6, RUNS)
    assert low <= tumbling[way].nees.mean() <= high


def test_the_textbook_filter_is_not(tumbling: dict[str, Course]) -> None:
    assert tumbling[STANDARD].nees[:, -1].mean() > 1.5 * tumbling[SINGLE].nees[:, -1].mean()


def test_joining_loses_nothing(tumbling: dict[str, Course]) -> None:
    assert tumbling[JOINED].submaps > 10
    assert tumbling[JOINED].rmse() <= 1.05 * tumbling[SINGLE].rmse()
