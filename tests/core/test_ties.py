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
from submaps.geometry.space import Space
from submaps.submap import Submap
from tests.core.atlases import CONFIGS, atlas, both_filters, both_spaces, chain

Floats = NDArray[np.float64]
HOLDS = [[0, 1, 2], [1, 2, 3], [0, 2, 3, 4], [1, 3, 4]]


def off(s: Submap, landmark: int, by: float) -> Submap:
    """The sub-map with one landmark first seen at a wrong place."""
    mean = s.mean.copy()
    mean[s.slot_of(landmark) : s.slot_of(landmark) + s.space.dim] += by
    return replace(s, mean=mean)


def replaced(submaps: list[Submap], k: int, landmark: int, by: float) -> list[Submap]:
    return [off(s, landmark, by) if s.number == k else s for s in submaps]


def gated(submaps: list[Submap]) -> AtlasState:
    return atlas(submaps, replace(CONFIGS[submaps[0].space], gate=0.999))


@both_spaces
@both_filters
@pytest.mark.parametrize(("k", "landmark"), [(2, 0), (1, 3), (3, 4)])
def test_innovation_is_that_against_the_map_without_the_tie(
    space: Space, invariant: bool, k: int, landmark: int
) -> None:
    """From its definition: solve with the pair untied, and compare what each side says of the landmark."""
    d = space.dim
    submaps = chain(HOLDS, space, seed=4, sigma=1e-4, invariant=invariant)  # small errors: the problem is linear
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
    entries = [start[v] + i for v in (a, b) for i in range(d)]
    columns = np.stack([factor.solve(np.eye(solved.pattern.size)[e])[entries] for e in entries], axis=1)
    D = np.hstack([np.eye(d), -np.eye(d)])
    difference = solved.points[a - solved.poses] - solved.points[b - solved.poses]
    assert found == pytest.approx(float(difference @ np.linalg.solve(D @ columns @ D.T, difference)), rel=1e-3)


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


@both_spaces
def test_a_wrong_first_sighting_is_taken_back(space: Space) -> None:
    good = chain(HOLDS, space, seed=1)
    solution = join(gated(replaced(good, 2, 0, 5.0)))
    assert solution.untied == {(2, 0)}
    honest = join(atlas([replace(s) for s in good]))
    without = join(atlas(without_landmark(good, 2, 0)))
    assert solution.frames == pytest.approx(without.frames, abs=1e-6)
    assert np.abs(solution.frames - honest.frames).max() < 0.2


def without_landmark(submaps: list[Submap], k: int, landmark: int) -> list[Submap]:
    """The sub-maps, one of them calling its landmark something else."""
    return [
        replace(s, landmarks=np.where(s.landmarks == landmark, 9, s.landmarks)) if s.number == k else s for s in submaps
    ]


def test_without_a_gate_every_tie_counts() -> None:
    assert join(atlas(replaced(chain(HOLDS, seed=1), 2, 0, 5.0))).untied == frozenset()


@both_spaces
def test_the_first_one_wrong_is_outvoted(space: Space) -> None:
    """The oldest holder is the wrong one: once two later ones agree, they keep the landmark."""
    holds = [[0, 1, 2, 5], [1, 2, 3, 5], [0, 2, 3, 4], [0, 1, 3, 4]]
    assert join(gated(replaced(chain(holds, space, seed=2), 0, 0, 5.0))).untied == {(0, 0)}


@both_spaces
def test_consistent_ties_stay(space: Space) -> None:
    dropped = [len(join(gated(chain(HOLDS, space, seed=seed))).untied) for seed in range(40)]
    assert sum(dropped) <= 2  # of 360 checks at 0.999


@both_spaces
def test_what_was_taken_back_stays_so_in_the_next_solve(space: Space) -> None:
    submaps = replaced(chain(HOLDS, space, seed=1), 2, 0, 5.0)
    first = join(gated(submaps))
    again = join(replace(gated(submaps), solution=first))
    assert again.untied == first.untied
    assert again.frames == pytest.approx(first.frames, abs=1e-6)
