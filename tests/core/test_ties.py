"""Ties held against the joined map before they count."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from submaps.atlas import ties
from submaps.atlas.joining import join
from submaps.atlas.solution import Components, factorised
from submaps.atlas.state import AtlasState
from submaps.consistency import chi_square_bound
from submaps.submap import Submap
from tests.core.support import ODOMETRY, R, atlas, chain

Floats = NDArray[np.float64]
GATED = replace(ODOMETRY, gate=0.999)
HOLDS = [[0, 1, 2], [1, 2, 3], [0, 2, 3, 4], [1, 3, 4]]


def off(s: Submap, landmark: int, by: float) -> Submap:
    """The sub-map with one landmark first seen at a wrong place."""
    mean = s.mean.copy()
    mean[s.slot_of(landmark) : s.slot_of(landmark) + 2] += by
    return replace(s, mean=mean)


def replaced(submaps: list[Submap], k: int, landmark: int, by: float) -> list[Submap]:
    return [off(s, landmark, by) if s.number == k else s for s in submaps]


@pytest.mark.parametrize(("k", "landmark"), [(2, 0), (1, 3), (3, 4)])
def test_innovation_is_that_against_the_map_without_the_tie(k: int, landmark: int) -> None:
    """From its definition: solve with the pair untied, and compare what each side says of the landmark."""
    submaps = chain(HOLDS, seed=4, sigma=1e-4)  # small errors: the problem is linear
    state = atlas(submaps)
    component = join(state).component(0)
    placed = component.placed(k, factorised(component).inverse_subset())
    found = ties.innovations(component, placed)[placed.shared.index(landmark)]
    # The tie as a landmark of its own, told apart by another number.
    apart = replace(submaps[k], landmarks=np.where(submaps[k].landmarks == landmark, 5, submaps[k].landmarks))
    world = atlas([*submaps[:k], apart, *submaps[k + 1 :]])
    # Both kept as variables: a further component holds them too, so that they count as shared.
    total = replace(world, sightings=[*world.sightings])
    free = Components(total, (), {})
    free._total = free._total + np.array([2] * free._total.shape[0])
    solved = free.of([0])
    component_values(solved, state)
    a, b = solved.variable_of(landmark), solved.variable_of(5)
    assert a is not None
    assert b is not None
    factor = factorised(solved)
    start = solved.pattern.start
    entries = [start[a], start[a] + 1, start[b], start[b] + 1]
    columns = np.stack([factor.solve(np.eye(solved.pattern.size)[e])[entries] for e in entries], axis=1)
    D = np.hstack([np.eye(2), -np.eye(2)])
    d = solved.points[a - solved.poses] - solved.points[b - solved.poses]
    assert found == pytest.approx(float(d @ np.linalg.solve(D @ columns @ D.T, d)), rel=1e-3)


def component_values(component: object, state: AtlasState) -> None:
    """Settle a component by Gauss-Newton from the joined values."""
    from submaps.atlas.component import Component
    from submaps.atlas.joining import _Solver

    assert isinstance(component, Component)
    component.frames[1:] = np.nan
    for f in component.unplaced():
        component.place(f)
    solver = _Solver.of(component)
    solver.converge(1e-10)


def test_a_wrong_first_sighting_is_taken_back() -> None:
    good = chain(HOLDS, seed=1)
    bad = atlas(replaced(good, 2, 0, 5.0), GATED)
    solution = join(bad)
    assert solution.untied == {(2, 0)}
    honest = join(atlas([replace(s) for s in good], ODOMETRY))
    without = join(atlas(without_landmark(good, 2, 0), ODOMETRY))
    assert solution.frames == pytest.approx(without.frames, abs=1e-6)
    assert np.abs(solution.frames - honest.frames).max() < 0.2


def without_landmark(submaps: list[Submap], k: int, landmark: int) -> list[Submap]:
    """The sub-maps, one of them calling its landmark something else."""
    return [
        replace(s, landmarks=np.where(s.landmarks == landmark, 9, s.landmarks)) if s.number == k else s for s in submaps
    ]


def test_without_a_gate_every_tie_counts() -> None:
    bad = atlas(replaced(chain(HOLDS, seed=1), 2, 0, 5.0), ODOMETRY)
    assert join(bad).untied == frozenset()


def test_the_first_one_wrong_is_outvoted() -> None:
    """The oldest holder is the wrong one: once two later ones agree, they keep the landmark."""
    holds = [[0, 1, 2, 5], [1, 2, 3, 5], [0, 2, 3, 4], [0, 1, 3, 4]]
    bad = atlas(replaced(chain(holds, seed=2), 0, 0, 5.0), GATED)
    assert join(bad).untied == {(0, 0)}


def test_consistent_ties_stay() -> None:
    dropped = [len(join(atlas(chain(HOLDS, seed=seed), GATED)).untied) for seed in range(40)]
    assert sum(dropped) <= 2  # of 360 checks at 0.999


def test_what_was_taken_back_stays_so_in_the_next_solve() -> None:
    submaps = replaced(chain(HOLDS, seed=1), 2, 0, 5.0)
    first = join(atlas(submaps, GATED))
    again = join(replace(atlas(submaps, GATED), solution=first))
    assert again.untied == first.untied
    assert again.frames == pytest.approx(first.frames, abs=1e-6)


def test_bound_is_two_dimensional() -> None:
    assert chi_square_bound(0.999, 2) == pytest.approx(-2.0 * np.log(0.001))
    assert R(0.0) == pytest.approx(np.eye(2))
