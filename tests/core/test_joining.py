"""Joining against dense least squares: values, covariances, recovered landmarks, replay."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import get_args

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks import linear
from submaps.atlas.joining import join
from submaps.atlas.solution import Solution
from submaps.atlas.view import View
from submaps.config import FilterName
from submaps.errors import MeasurementError, NumericalError
from submaps.geometry.space import PLANE, SOLID, Space
from submaps.mapper import Mapper
from submaps.submap import Submap
from tests.core.atlases import (
    Dense,
    apart,
    atlas,
    both_filters,
    both_spaces,
    chain,
    dense_join,
    drive,
    forgotten,
    pack,
    submap,
)
from tests.core.filters import after
from tests.core.support import ODOMETRY, cut, laps

Floats = NDArray[np.float64]
# Landmarks 0 and 1 join the last sub-maps to the first; 20 .. 29 are each held by one sub-map alone.
LOOP = [[0, 1, 2, 20], [2, 3, 21, 22], [3, 4, 5, 23], [4, 24, 5], [6, 5, 25], [6, 0, 26, 1], [1, 0, 2, 27]]

# Each shares with the one before, and no other, landmarks enough to tell how it lies.
OVERLAPPING = [[0, 1, 2, 3], [0, 1, 2, 3, 4, 5, 6], [5, 4, 6, 7, 8, 9], [6, 7, 8, 9], [7, 8, 9, 10]]


@cache
def solved(space: Space, invariant: bool, seed: int) -> tuple[list[Submap], Solution, Dense]:
    held = chain(LOOP, space, seed=seed, invariant=invariant)
    return held, join(atlas(held)), dense_join(held)


@both_filters
@pytest.mark.parametrize(("space", "seed"), [(PLANE, 0), (PLANE, 1), (SOLID, 1)])
def test_a_loop_equals_the_dense_optimum(space: Space, seed: int, invariant: bool) -> None:
    held, solution, dense = solved(space, invariant, seed)
    assert np.abs(apart(space, solution.frames, dense.frames[:-1])).max() < 1e-7
    assert np.abs(apart(space, solution.ends, dense.frames[-1])).max() < 1e-7
    assert solution.cost == pytest.approx(dense.cost, rel=1e-7)
    component = solution.component(0)
    shared = [dense.landmark(i) for i in component.landmarks]
    assert component.landmarks == [0, 1, 2, 3, 4, 5, 6]
    assert np.allclose(solution.landmarks, shared, atol=1e-7)
    assert atlas(held).digest() == atlas(held).digest()


@both_spaces
def test_without_noise_the_world_comes_back(space: Space) -> None:
    held = chain(LOOP, space, seed=2, sigma=1e-9)
    frames, world = drive(space, np.random.default_rng(2), len(LOOP), 28)
    solution = join(atlas(held))
    assert np.abs(apart(space, solution.frames, np.array(frames[:-1]))).max() < 1e-7
    view = View(replace(atlas(held), solution=solution))
    for i in sorted({i for holds in LOOP for i in holds}):
        assert view.landmark(f"L{i}").position == pytest.approx(world[i], abs=1e-7)


@both_spaces
@both_filters
def test_joint_covariances_equal_the_dense_inverse(space: Space, invariant: bool) -> None:
    held, solution, dense = solved(space, invariant, 1)
    for k in range(len(held)):
        placed = solution.placed(k)
        expected = dense.joint(k, placed.shared)
        scale = np.sqrt(np.diag(expected))
        scale[scale == 0.0] = 1.0
        assert np.abs((placed.covariance - expected) / np.outer(scale, scale)).max() < 1e-6
    found = solution.point(0, 5)
    assert found is not None
    point, covariance = found
    at = dense.landmark_at(5)
    assert point == pytest.approx(dense.landmark(5), abs=1e-7)
    assert np.allclose(covariance, dense.covariance[np.ix_(at, at)], rtol=1e-5)
    assert solution.point(0, 21) is None


@both_spaces
@both_filters
def test_landmarks_of_one_submap_are_recovered(space: Space, invariant: bool) -> None:
    held, solution, dense = solved(space, invariant, 1)
    for k, s in enumerate(held):
        for number in s.slots():
            point, covariance = solution.placed(k).landmark(number)
            at = dense.landmark_at(number)
            expected = dense.covariance[np.ix_(at, at)]
            assert np.allclose(point, dense.landmark(number), atol=2e-7)
            # The second derivative by xi_theta is taken to first order.
            assert np.allclose(covariance, expected, rtol=2e-3, atol=2e-3 * float(np.trace(expected)))


@both_filters
def test_a_loop_solvable_by_hand(invariant: bool) -> None:
    """A square of four sub-maps a side of 4 m: a gap of (0.4, 0) m is spread evenly over equal sides."""
    P = np.diag([0.01, 0.01, 1e-16])  # the headings are all but certain
    side = np.array([4.0, 0.0, 0.5 * math.pi])
    held = []
    for k in range(4):
        mark = [0.0, 0.0] if k == 0 else [4.0, 0.0] if k == 3 else []
        whole = np.zeros((3 + len(mark),) * 2)
        whole[:3, :3] = P
        whole[3:, 3:] = np.eye(len(mark)) * 1e-10  # the landmark at the start, seen with hardly any noise
        mean = np.concatenate([side, mark])
        if k == 0:
            mean[0] += 0.4
        held.append(submap(k, [0] if mark else [], mean, whole, following=k + 1 if k < 3 else -1, invariant=invariant))
    solution = join(atlas(held))
    third = 0.4 / 3  # three sides lead to where the landmark is seen again, all equally sure
    expected = [(0.0, 0.0), (4.4 - third, 0.0), (4.4 - 2.0 * third, 4.0), (0.0, 4.0)]
    assert np.allclose(solution.frames[:, :2], expected, atol=1e-4)
    assert np.allclose(np.cos(solution.frames[:, 2] - 0.5 * np.pi * np.arange(4)), 1.0, atol=1e-8)
    assert solution.landmarks[0] == pytest.approx((0.0, 0.0), abs=1e-4)
    assert solution.cost == pytest.approx(3 * third**2 / 0.01, rel=1e-3)


@both_spaces
def test_a_line_with_nothing_to_close_is_the_odometry_chain(space: Space) -> None:
    held = chain([[0], [1], [2]], space, seed=3)
    solution, dense = join(atlas(held)), dense_join(held)
    pose = np.zeros(space.pose)
    for k, s in enumerate(held):
        assert np.abs(apart(space, solution.frames[k], pose)).max() < 1e-12
        pose = after(space, pose, s.mean[: space.pose])
    assert solution.cost == pytest.approx(0.0, abs=1e-12)
    assert dense.cost == pytest.approx(0.0, abs=1e-12)
    assert solution.landmarks.shape == (0, space.dim)


def test_solving_in_steps_ends_where_solving_at_once_does() -> None:
    whole = laps(24, seed=3)
    config = replace(ODOMETRY, max_landmarks=6)
    stepwise, at_once = Mapper(config), Mapper(config)
    solves = 0
    for k in range(0, whole.steps, 5):
        for mapper in (stepwise, at_once):
            mapper.apply("a", cut(whole, k, min(k + 5, whole.steps)))
        if stepwise.solve_due:
            stepwise.install(join(stepwise.problem()))
            solves += 1
    assert solves > 2
    last = [join(mapper.problem()) for mapper in (stepwise, at_once)]
    assert np.allclose(last[0].frames, last[1].frames, atol=1e-6)
    assert np.allclose(last[0].landmarks, last[1].landmarks, atol=1e-6)
    assert last[0].cost == pytest.approx(last[1].cost, rel=1e-6)
    assert last[0].iterations < last[1].iterations


def test_a_submap_without_a_positive_definite_covariance_is_an_error() -> None:
    held = chain([[0, 1], [0, 1]])
    bad = held[0].covariance()
    bad[3, 3] = -1e-6
    with pytest.raises(NumericalError, match="submap 0"):
        join(atlas([replace(held[0], packed=pack(bad)), held[1]]))


@both_spaces
@both_filters
@pytest.mark.parametrize("sigma", [0.05, 1e-4])
def test_submaps_that_forget_their_ends_tie_by_shared_landmarks(space: Space, invariant: bool, sigma: float) -> None:
    """As where no motion is measured: an information of 1e-6 beside one of up to 1e8."""
    held = chain(OVERLAPPING, space, seed=3, sigma=sigma, invariant=invariant)
    flat = [*(forgotten(s) for s in held[:-1]), held[-1]]
    solution, dense = join(atlas(flat)), dense_join(flat)
    for k in range(1, len(flat)):
        placed = solution.placed(k)
        expected = dense.joint(k, placed.shared)
        scale = np.sqrt(np.diag(expected))
        assert np.abs(apart(space, solution.frames[k], dense.frames[k]) / scale[: space.pose]).max() < 1e-5
        assert np.abs((placed.covariance - expected) / np.outer(scale, scale)).max() < 1e-5
        assert scale[: space.dim].max() < 20.0 * sigma  # as sure as landmarks make it


# -- a linear world ----------------------------------------------------------------------------


@pytest.mark.parametrize("filter_name", get_args(FilterName))
def test_a_linear_world_equals_the_batch(filter_name: FilterName) -> None:
    """With the heading known nothing is approximated: sub-maps lose nothing when they are joined."""
    difference, submaps = linear.difference(filter_name)
    assert submaps > 4
    assert difference < 1e-9


# -- replay ------------------------------------------------------------------------------------


def test_columns_carry_a_solution_bit_for_bit() -> None:
    whole = laps(24, seed=4)
    mapper = Mapper(replace(ODOMETRY, max_landmarks=6))
    mapper.apply("a", cut(whole, 0, 50))
    mapper.install(join(mapper.problem()))
    mapper.apply("a", cut(whole, 50, whole.steps))
    state = mapper.problem()
    solution = join(state)
    kept = {name: np.frombuffer(c.tobytes()).reshape(c.shape) for name, c in solution.columns().items()}
    again = Solution.from_columns(state, kept)
    assert (again.iterations, again.cost) == (solution.iterations, solution.cost)
    for k in range(state.submap_count):
        a, b = solution.placed(k), again.placed(k)
        assert (a.frame, a.end, a.shared) == (b.frame, b.end, b.shared)
        assert np.array_equal(a.covariance, b.covariance)
        for number in a.submap.slots():
            assert all(np.array_equal(x, y) for x, y in zip(a.landmark(number), b.landmark(number), strict=True))


@both_spaces
def test_columns_of_a_loop_carry_it_too(space: Space) -> None:
    state = atlas(chain(LOOP, space))
    solution = join(state)
    again = Solution.from_columns(state, solution.columns())
    for k in range(state.submap_count):
        assert np.array_equal(again.placed(k).covariance, solution.placed(k).covariance)
        assert again.placed(k).frame == solution.placed(k).frame


def test_columns_of_another_state_are_refused() -> None:
    state = atlas(chain(LOOP))
    columns = join(state).columns()
    with pytest.raises(MeasurementError):
        Solution.from_columns(atlas(chain(LOOP[:-1])), columns)


def test_the_digest_names_everything_that_a_solve_reads() -> None:
    held = chain([[0, 1], [1, 0, 2]])
    state = atlas(held)
    digests = {state.digest()}
    first = held[0]
    nudged = first.packed.copy()
    nudged[3] = np.nextafter(nudged[3], 1.0)
    mean = first.mean.copy()
    mean[4] = np.nextafter(mean[4], 1.0)
    changes = [
        replace(first, mean=mean), replace(first, packed=nudged), replace(first, invariant=False),
        replace(first, landmarks=first.landmarks[::-1].copy()), replace(first, previous=3), replace(first, robot=1),
    ]  # fmt: skip
    for changed in changes:
        digests.add(replace(state, records=[changed, None]).digest())
    digests.add(atlas([held[0], replace(held[1], mean=held[1].mean + 1e-12)]).digest())
    solution = join(state)
    digests.add(replace(state, solution=solution).digest())
    moved = {name: c.copy() for name, c in solution.columns().items()}
    moved["frames"][1, 0] += 1e-12
    digests.add(replace(state, solution=Solution.from_columns(state, moved)).digest())
    moved = {name: c.copy() for name, c in solution.columns().items()}
    moved["landmarks"][0, 0] += 1e-12
    digests.add(replace(state, solution=Solution.from_columns(state, moved)).digest())
    assert len(digests) == 1 + len(changes) + 4
    assert atlas(chain([[0, 1], [1, 0, 2]])).digest() == state.digest()


def test_a_second_robot_is_a_component_of_its_own() -> None:
    mine = chain([[0, 1], [1, 0]], seed=1)
    first, second = (replace(s, robot=1, landmarks=s.landmarks + 2) for s in chain([[0, 1], [1, 0]], seed=2))
    theirs = [replace(first, number=2, previous=-1, following=3), replace(second, number=3, previous=2)]
    both = join(atlas([*mine, *theirs]))
    alone = join(atlas(mine))
    assert np.allclose(both.frames[:2], alone.frames, atol=1e-9)
    assert np.allclose(both.ends[0], alone.ends[0], atol=1e-9)
    other = dense_join(chain([[0, 1], [1, 0]], seed=2))
    assert np.allclose(both.frames[2:], other.frames[:2], atol=1e-7)
    assert View(atlas([*mine, *theirs])).submap_count == 4
