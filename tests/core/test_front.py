"""Between two solves: what the frontier says of the newest sub-maps, against the dense joint."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from submaps.atlas.front import Front, condition
from submaps.atlas.joining import join
from submaps.atlas.placed import Placed
from submaps.atlas.view import View
from submaps.geometry.space import Space
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
    forgotten,
    moved,
    slopes,
    submap,
)
from tests.core.filters import minus
from tests.core.support import ODOMETRY, Step, batch, cut, laps, random_covariance

Floats = NDArray[np.float64]
SMALL = 1e-4  # noise so small that linearisation does not count
NEIGHBOURS = [[0, 1, 20], [1, 2, 3], [3, 2, 4, 21], [4, 5, 22], [5, 6, 4, 7], [7, 6, 23]]
OVERLAPPING = [[0, 1, 2, 3], [0, 1, 2, 3, 4, 5, 6], [5, 4, 6, 7, 8, 9], [6, 7, 8, 9], [7, 8, 9, 10]]
LOOP = [[0, 1, 20], [1, 2, 3], [3, 2, 0, 21], [4, 3, 1, 22], [5, 4, 30], [6, 5, 30, 31], [6, 31, 32]]


def deviation(placed: Placed, k: int, dense: Dense) -> tuple[float, float]:
    """Greatest difference of values and of covariances, in standard deviations."""
    expected = dense.joint(k, placed.shared)
    sigma = np.sqrt(np.diag(expected))
    sigma[sigma == 0.0] = 1.0
    poses = apart(dense.space, np.array([placed.frame, placed.end]), dense.frames[k : k + 2])
    points = [placed.points[i] - dense.landmark(number) for i, number in enumerate(placed.shared)]
    by_value = float(np.abs(np.concatenate([poses.ravel(), *points]) / sigma).max())
    return by_value, float(np.abs((placed.covariance - expected) / np.outer(sigma, sigma)).max())


@both_spaces
@both_filters
@pytest.mark.parametrize("count", [1, 2, 4, 6])
def test_without_a_solve_ties_to_neighbours_give_the_joint(space: Space, invariant: bool, count: int) -> None:
    held = chain(NEIGHBOURS[:count], space, sigma=SMALL, seed=1, invariant=invariant)
    placed = View(atlas(held)).placed(count - 1)
    by_value, by_covariance = deviation(placed, count - 1, dense_join(held))
    assert by_value < 3e-3
    assert by_covariance < 3e-3


@both_spaces
@both_filters
def test_conditioning_is_least_squares_on_the_front_and_the_submap(space: Space, invariant: bool) -> None:
    """Also where the frame turns far: the front speaks of the rotation vector from its own frame on."""
    d, p, rng = space.dim, space.pose, np.random.default_rng(7)
    s = chain([[0, 1, 2]], space, sigma=0.1, seed=7, invariant=invariant)[0]
    count = p + 2 * d
    information = np.linalg.inv(random_covariance(rng, count, 0.3))
    information = 0.5 * (information + information.T)
    frame = np.concatenate([rng.normal(size=d), 0.5 * rng.normal(size=space.rot)])
    points = s.mean[p : p + 2 * d].reshape(2, d) + 0.3 * rng.normal(size=(2, d))
    front = Front(space.as_pose(frame), [0, 1], points, information, 2.0 * rng.normal(size=count), False)
    found = condition(front, s)
    root = np.linalg.cholesky(information).T
    offset = np.linalg.solve(information, front.vector)
    rows = np.arange(p + 2 * d)
    whiten = np.linalg.inv(np.linalg.cholesky(s.covariance(rows)))

    def residuals(x: Floats) -> Floats:
        increment, end, own = x[:p], moved(space, s.mean[:p], x[p : 2 * p]), points.ravel() + x[2 * p :]
        said = root @ (np.concatenate([increment, x[2 * p :]]) + offset)
        return np.concatenate([said, whiten @ minus(space, np.concatenate([end, own]), s.mean[rows], invariant)])

    best = least_squares(residuals, np.zeros(2 * p + 2 * d), xtol=1e-15, ftol=1e-15, gtol=1e-13).x
    assert np.linalg.norm(best[d:p]) > 0.05
    assert np.abs(apart(space, np.array(found.frame), moved(space, frame, best[:p]))).max() < 1e-6
    assert np.abs(apart(space, np.array(found.end), moved(space, s.mean[:p], best[p : 2 * p]))).max() < 1e-6
    assert found.points.ravel() == pytest.approx(points.ravel() + best[2 * p :], abs=1e-6)

    def after_more(e: Floats) -> Floats:
        """Residuals with an increment on the frame as it was found."""
        turned_to = apart(space, moved(space, np.array(found.frame), e[:p]), frame)[0]
        end = apart(space, moved(space, np.array(found.end), e[p : 2 * p]), s.mean[:p])[0]
        return residuals(np.concatenate([turned_to, end, found.points.ravel() - points.ravel() + e[2 * p :]]))

    J = slopes(after_more, best.shape[0])
    assert np.allclose(found.covariance, np.linalg.inv(J.T @ J), rtol=1e-6, atol=1e-9)


def last_as_of_then(held: list[Submap], k: int, seed: int) -> Submap:
    """Sub-map k while it was still active: fewer landmarks, another estimate."""
    s, space = held[k], held[k].space
    count = max(1, len(s.landmarks) - 1)
    rng = np.random.default_rng(seed)
    rows = np.arange(space.pose + space.dim * count)
    P = random_covariance(rng, rows.shape[0], SMALL)
    mean = s.mean[rows] + np.linalg.cholesky(P) @ rng.normal(size=rows.shape[0])
    mean[: space.pose] = s.mean[: space.pose] * 0.6  # and half the way
    return submap(k, s.landmarks[:count].tolist(), mean, P, invariant=s.invariant)


@both_spaces
@both_filters
@pytest.mark.parametrize("solved_at", [0, 2, 4])
def test_after_a_solve_nothing_is_lost_or_counted_twice(space: Space, invariant: bool, solved_at: int) -> None:
    """The solve took a half-done sub-map in; what it said then is taken out before what it says now."""
    # With a loop, later ties to older sub-maps would have to wait for another solve.
    held = chain(LOOP if solved_at >= 3 else NEIGHBOURS, space, sigma=SMALL, seed=2, invariant=invariant)
    then = [*held[:solved_at], last_as_of_then(held, solved_at, 3)]
    solution = join(atlas(then))
    for count in {solved_at + 1, len(held)}:
        now = [*held[: count - 1], replace(held[count - 1], following=-1)]
        view = View(replace(atlas(now), solution=solution))
        by_value, by_covariance = deviation(view.placed(count - 1), count - 1, dense_join(now))
        assert by_value < 5e-3
        assert by_covariance < 5e-3


@both_spaces
@both_filters
def test_ties_to_older_submaps_wait_and_are_never_invented(space: Space, invariant: bool) -> None:
    """Less is used than there is: the covariance is nowhere below the full joint's."""
    held = chain(LOOP, space, sigma=SMALL, seed=4, invariant=invariant)
    for solved_at, places in {None: {2, 3, 6}, 1: {1, 3, 6}, 2: {2, 6}}.items():
        solution = None if solved_at is None else join(atlas([*held[:solved_at], last_as_of_then(held, solved_at, 5)]))
        for k in places:
            now = [*held[:k], replace(held[k], following=-1)]
            placed = View(replace(atlas(now), solution=solution)).placed(k)
            full = joint_of(space, invariant, k, tuple(placed.shared))
            scale = np.sqrt(np.diag(full))
            more = (placed.covariance - full) / np.outer(scale, scale)
            assert float(np.linalg.eigvalsh(0.5 * (more + more.T))[0]) > -1e-3
            if k >= 3 and solved_at is None:
                assert float(np.diag(more).max()) > 1e-2  # and the loop is indeed left out


@cache
def joint_of(space: Space, invariant: bool, k: int, shared: tuple[int, ...]) -> Floats:
    """The full joint of the sub-map k of ``LOOP`` while it is the last."""
    held = chain(LOOP, space, sigma=SMALL, seed=4, invariant=invariant)
    return dense_join([*held[:k], replace(held[k], following=-1)]).joint(k, shared)


@both_spaces
@both_filters
def test_ends_that_were_forgotten_leave_what_landmarks_say(space: Space, invariant: bool) -> None:
    """Without motion: each sub-map may lie anywhere about the one before, but for the landmarks that both hold."""
    held = chain(OVERLAPPING, space, sigma=SMALL, seed=3, invariant=invariant)
    flat = [*(forgotten(s) for s in held[:-1]), held[-1]]
    last, dense = len(flat) - 1, dense_join(flat)
    views = [View(atlas(flat))]
    then = [*flat[:2], replace(held[2], following=-1)]
    views.append(View(replace(atlas(flat), solution=join(atlas(then)))))
    for view in views:
        by_value, by_covariance = deviation(view.placed(last), last, dense)
        assert by_value < 3e-3
        assert by_covariance < 5e-3
        assert np.sqrt(np.diag(view.pose("r0").covariance)[: space.dim]).max() < 100.0 * SMALL


@both_spaces
def test_where_nothing_is_shared_the_place_is_open_and_nothing_fails(space: Space) -> None:
    held = chain([[0, 1, 2, 3], [4, 5, 6, 7], [4, 5, 6, 8]], space, sigma=0.02, seed=3)
    flat = [*(forgotten(s) for s in held[:-1]), held[-1]]
    solved = View(replace(atlas(flat), solution=join(atlas(flat))))
    for view in (View(atlas(flat)), solved):
        assert np.sqrt(np.diag(view.pose("r0").covariance)).min() > 9.0
        assert np.sqrt(np.diag(view.landmark("L1").covariance)).max() < 0.1
        local = view.pose("r0", "submap/2")
        assert np.sqrt(np.diag(local.covariance)).max() < 0.1


@both_filters
def test_just_after_a_solve_it_is_the_solution(invariant: bool) -> None:
    whole = laps(24, seed=3)
    name = "invariant" if invariant else "standard"
    mapper = Mapper(replace(ODOMETRY, max_landmarks=6, filter=name))  # type: ignore[arg-type]
    mapper.apply("a", cut(whole, 0, 61))
    solution = join(mapper.problem())
    mapper.install(solution)
    view = mapper.view()
    last = view.submap_count - 1
    assert last > 4
    for k in range(view.submap_count):
        placed, own = view.placed(k), solution.placed(k)
        assert placed.frame == own.frame
        assert np.array_equal(placed.covariance, own.covariance)
        assert view.frame_in(k, "map") == tuple(solution.frames[k])
    pose = view.pose("a")
    assert (pose.x, pose.y, pose.theta) == tuple(solution.ends[0])
    assert np.array_equal(pose.covariance, solution.placed(last).end_covariance)
    # A step that brings nothing new hardly moves it.
    mapper.apply("a", cut(whole, 61, 62))
    later = mapper.view().pose("a")
    assert np.allclose(later.covariance, pose.covariance, rtol=0.5)


def test_a_solve_that_comes_late_joins_what_happened_meanwhile() -> None:
    """Ingest goes on while a solve runs; installed late, the active sub-map continues from it."""
    whole = laps(24, seed=5)
    mapper = Mapper(replace(ODOMETRY, max_landmarks=6))
    mapper.apply("a", cut(whole, 0, 50))
    late = join(mapper.problem())
    mapper.apply("a", cut(whole, 50, whole.steps))
    before = mapper.view()
    mapper.install(late)
    view = mapper.view()
    assert view.version == before.version + 1
    assert view.submap_count > late.base.submap_count
    pose = view.pose("a")
    np.linalg.cholesky(pose.covariance)
    mapper.install(join(mapper.problem()))
    best = mapper.view().pose("a")
    assert np.linalg.det(pose.covariance) > np.linalg.det(best.covariance)
    error = np.array([pose.x - best.x, pose.y - best.y, pose.theta - best.theta])
    error[2] = np.remainder(error[2] + np.pi, 2.0 * np.pi) - np.pi
    assert float(error @ np.linalg.solve(pose.covariance, error)) < 16.3  # chi-square, 3 dof, 0.999


def test_map_to_odom_takes_dead_reckoning_to_the_estimate() -> None:
    mapper = Mapper(replace(ODOMETRY, max_landmarks=6))
    mapper.apply("a", laps(24, seed=6))
    mapper.install(join(mapper.problem()))
    view = mapper.view()
    best, odom = view.pose("a"), view.pose("a", "odom")
    assert best.map_T_odom is not None
    x, y, theta = best.map_T_odom
    c, s = np.cos(theta), np.sin(theta)
    assert (x + c * odom.x - s * odom.y, y + s * odom.x + c * odom.y) == pytest.approx((best.x, best.y), abs=1e-9)
    assert np.cos(theta + odom.theta - best.theta) == pytest.approx(1.0)
    assert odom.kind == "dead_reckoning"
    assert best.kind == "joined"


def test_far_away_and_little_known_is_still_placed() -> None:
    """Ten kilometres along a street without loops or solves: metres of doubt beside millimetres."""
    rng = np.random.default_rng(0)
    mapper = Mapper(ODOMETRY)
    for k in range(0, 10_000, 200):
        x = np.arange(k, k + 200)
        seen = [
            [(f"{i}", (10.0 * i - x_ + 0.1 * rng.normal(), 3.0)) for i in range(x_ // 10, x_ // 10 + 2)] for x_ in x
        ]
        control = [tuple(c) for c in np.array([1.0, 0.0, 0.0]) + rng.normal(size=(200, 3)) * ODOMETRY.motion.sigma]
        steps = [Step(c if i else None, s) for i, c, s in zip(x, control, seen, strict=True)]
        mapper.apply("r", batch(steps, start=0.1 * k))
        found = mapper.view().pose("r")
        assert np.all(np.linalg.eigvalsh(found.covariance) > 0.0)
    solved = join(mapper.problem())
    mapper.install(solved)
    now = mapper.view().pose("r")
    assert found.covariance == pytest.approx(now.covariance, rel=0.2)
