"""Robots on one map: components that meet, starts, and what is not connected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from submaps.atlas.joining import join
from submaps.atlas.solution import Solution
from submaps.atlas.state import AtlasState
from submaps.atlas.view import View
from submaps.config import MapConfig, MotionConfig, ObservationConfig, RobotConfig, Start
from submaps.consistency import average_bounds
from submaps.errors import NotConnected
from submaps.geometry.se2 import between, compose, inverse
from submaps.geometry.space import PLANE, SOLID, Space
from submaps.mapper import Mapper
from submaps.simulation import two_ways
from submaps.submap import Submap
from tests.core.atlases import CONFIGS, apart, atlas, both_spaces, inside, moved, relative, submap
from tests.core.filters import after, minus, plus
from tests.core.support import ODOMETRY, Step, batch, cut, random_covariance

Floats = NDArray[np.float64]


def fleet(
    holds: list[list[list[int]]], space: Space = PLANE, seed: int = 0, sigma: float = 0.03, world: Floats | None = None
) -> tuple[list[Submap], Floats, Floats]:
    """Noisy sub-maps of several robots in one world, the last of each active; true frames, landmarks.

    Numbers alternate between robots as they would live.
    """
    rng, d = np.random.default_rng(seed), space.dim
    count = 1 + max(i for chain in holds for held in chain for i in held)
    if world is None:
        world = rng.uniform(-8.0, 8.0, size=(count, d))
    order = sorted((k, robot) for robot, chain in enumerate(holds) for k in range(len(chain)))
    number = {key: i for i, key in enumerate(order)}
    begin = np.array([3.0, 1.0, 0.7] if d == 2 else [3.0, 1.0, -2.0, 0.7, -0.4, 0.2])
    pose = [begin * robot for robot in range(len(holds))]
    made, frames = [], np.zeros((len(order), space.pose))
    for k, robot in order:
        frame, held, last = pose[robot], holds[robot][k], k == len(holds[robot]) - 1
        increment = np.concatenate([[2.0], rng.normal(size=space.pose - 1) * 0.4])
        pose[robot] = after(space, frame, increment)
        truth = np.concatenate([relative(space, frame, pose[robot]), inside(space, frame, world[held]).ravel()])
        P = random_covariance(rng, truth.shape[0], sigma)
        mean = plus(space, truth, np.linalg.cholesky(P) @ rng.normal(size=truth.shape[0]), False)
        frames[number[k, robot]] = frame
        following = -1 if last else number[k + 1, robot]
        previous = number[k - 1, robot] if k else -1
        made.append(submap(number[k, robot], held, mean, P, following=following, previous=previous, robot=robot))
    return made, frames, world


def optimum(submaps: list[Submap], guess: Floats, world: Floats) -> tuple[Floats, Floats]:
    """Frames and their covariance by a general least-squares solver with every landmark kept; frame 0 is fixed."""
    space = submaps[0].space
    d, p, count = space.dim, space.pose, len(submaps)
    ends = [s.number for s in submaps if s.active]
    used = sorted({int(i) for s in submaps for i in s.landmarks})
    roots = [np.linalg.inv(np.linalg.cholesky(s.covariance())) for s in submaps]
    poses = np.vstack([guess, *(after(space, guess[k], submaps[k].mean[:p]) for k in ends)])
    points, free = world[used], p * (len(submaps) + len(ends) - 1)

    def at(x: Floats) -> tuple[Floats, Floats]:
        rest = [moved(space, pose, e) for pose, e in zip(poses[1:], x[:free].reshape(-1, p), strict=True)]
        return np.vstack([poses[0], *rest]), points + x[free:].reshape(-1, d)

    def residuals(x: Floats) -> Floats:
        there, seen = at(x)
        out = []
        for s, W in zip(submaps, roots, strict=True):
            frame = there[s.number]
            end = there[count + ends.index(s.number)] if s.active else there[s.following]
            local = inside(space, frame, seen[[used.index(int(i)) for i in s.landmarks]])
            predicted = np.concatenate([relative(space, frame, end), local.ravel()])
            out.append(W @ minus(space, predicted, s.mean, True))
        return np.concatenate(out)

    for tolerance in (1e-4, 1e-12):  # the second about the first's result: so its derivatives are by increments
        found = least_squares(residuals, np.zeros(free + points.size), jac="3-point", xtol=1e-15, gtol=tolerance)
        poses, points = at(found.x)
    return poses[:count], np.linalg.inv(found.jac.T @ found.jac)[: p * (count - 1), : p * (count - 1)]


HOLDS = [[[0, 1], [1, 2, 3], [3, 4]], [[5, 6], [2, 6, 4], [3, 7]]]


@both_spaces
def test_components_that_meet_are_solved_as_one(space: Space) -> None:
    submaps, truth, world = fleet(HOLDS, space)
    solution = join(atlas(submaps))
    assert solution.roots == [0, 0]
    expected, covariance = optimum(submaps, truth, world)
    assert np.abs(apart(space, solution.frames, expected)).max() < 1e-6
    last = slice(4 * space.pose, 5 * space.pose)
    assert solution.placed(5).frame_covariance == pytest.approx(covariance[last, last], rel=1e-3, abs=1e-8)


@both_spaces
def test_a_solution_comes_back_from_its_columns_with_the_same_bits(space: Space) -> None:
    submaps, _, _ = fleet(HOLDS, space)
    state = atlas(submaps)
    solution = join(state)
    again = Solution.from_columns(state, solution.columns())
    assert again.roots == solution.roots
    for number in range(len(submaps)):
        assert np.array_equal(again.placed(number).covariance, solution.placed(number).covariance)


@both_spaces
def test_it_does_not_matter_when_they_met(space: Space) -> None:
    submaps, _, _ = fleet(HOLDS, space)
    early = [replace_following(s, -1) for s in submaps[:4]]
    first = join(atlas(early))
    later = replace(atlas(submaps), solution=first)
    assert join(later).frames == pytest.approx(join(atlas(submaps)).frames, abs=1e-6)


def replace_following(s: Submap, end: int) -> Submap:
    """The sub-map as it was when it, or the one after it, was active."""
    return replace(s, following=s.following if s.following in range(4) else end)


@pytest.mark.parametrize(
    ("space", "holds"),
    [
        (PLANE, [[[0, 1], [1, 2]], [[3, 2], [3, 4]]]),
        (PLANE, [[[0], [1]], [[2], [3]]]),
        (SOLID, [[[0, 1], [1, 2]], [[3, 2], [3, 1]]]),
    ],
    ids=["one landmark", "none", "two in space"],
)
def test_too_little_in_common_ties_nothing(space: Space, holds: list[list[list[int]]]) -> None:
    submaps, _, _ = fleet(holds, space)
    assert join(atlas(submaps)).roots == [0, 1]


@both_spaces
def test_landmarks_too_near_each_other_tie_nothing(space: Space) -> None:
    submaps, _, _ = fleet(HOLDS, space, sigma=3.0)
    assert join(atlas(submaps)).roots == [0, 1]


def test_landmarks_on_a_line_tie_nothing_in_space() -> None:
    """However many there are, and far apart: they may be turned about it."""
    holds = [[[0, 1, 2], [2, 3, 4]], [[0, 1, 2], [3, 4, 5]]]
    world = np.outer(np.arange(6.0), [4.0, 1.0, -2.0])
    assert join(atlas(fleet(holds, SOLID, sigma=0.01, world=world)[0])).roots == [0, 1]
    world[1] += (0.0, 3.0, 0.0)
    assert join(atlas(fleet(holds, SOLID, sigma=0.01, world=world)[0])).roots == [0, 0]


@both_spaces
def test_landmarks_that_do_not_fit_tie_nothing(space: Space) -> None:
    submaps, _, _ = fleet(HOLDS, space, sigma=0.01)
    wrong = replace(submaps[3], landmarks=submaps[3].landmarks[[2, 1, 0]])  # two names exchanged
    state = atlas([*submaps[:3], wrong, *submaps[4:]])
    assert join(state).roots == [0, 1]


@both_spaces
def test_with_a_gate_the_largest_set_that_agrees_ties(space: Space) -> None:
    """One of eight landmarks in common is another's: the rest tie, and it is named."""
    holds = [[[0, 1, 2, 3], [3, 4, 5, 6, 7]], [[0, 1, 2, 3], [3, 4, 5, 6, 7]]]
    submaps, truth, _ = fleet(holds, space, seed=3)
    mean, slot = submaps[3].mean.copy(), submaps[3].slot_of(5)
    mean[slot : slot + space.dim] += 4.0
    state = atlas([*submaps[:3], replace(submaps[3], mean=mean)], replace(CONFIGS[space], gate=0.999))
    solution = join(state)
    assert solution.roots == [0, 0]
    assert solution.untied == {(3, 5)}
    assert np.abs(apart(space, solution.frames, truth)).max() < 0.3


def test_robots_from_far_apart_meet_consistently() -> None:
    """Two robots 100 m apart that know nothing of each other pass after 1 000 steps: 30 runs."""
    scores: list[list[float]] = [[], []]
    config = MapConfig(MotionConfig("velocity", (0.05, np.deg2rad(1.0))), ObservationConfig("cartesian", (0.15, 0.15)))
    for seed in range(30):
        mapper = Mapper(config)
        runs = two_ways(np.random.default_rng(seed))
        met = []
        for begin in range(0, 1301, 100):
            for name, run in runs.items():
                mapper.apply(name, cut(run.batch, begin, min(begin + 100, 1301)))
            if mapper.solve_due:
                mapper.install(join(mapper.problem()))
            met.append(mapper.view().connected(1))
        mapper.install(join(mapper.problem()))
        assert not any(met[:8])
        origin = runs["east"].poses[0]
        for score, (name, run) in zip(scores, runs.items(), strict=True):
            found = mapper.view().pose(name, "map")
            true = between(tuple(origin), tuple(run.poses[-1]))
            error = np.array(
                [found.x - true[0], found.y - true[1], (found.theta - true[2] + np.pi) % (2 * np.pi) - np.pi]
            )
            assert np.all(np.abs(error) < 3.0 * np.sqrt(np.diag(found.covariance))), (seed, name)
            score.append(float(error @ np.linalg.solve(found.covariance, error)) / 3.0)
    low, high = average_bounds(0.95, 3, 30)
    assert low < np.mean(scores[0]) < high
    assert low < np.mean(scores[1]) < high


# -- starts --------------------------------------------------------------------------------------

SPREAD = ((0.04, 0.0, 0.0), (0.0, 0.09, 0.0), (0.0, 0.0, 0.01))


def own(start: Start) -> RobotConfig:
    return RobotConfig(ODOMETRY.motion, ODOMETRY.observation, start)


def pair(a: str, b: str) -> list[tuple[str, tuple[float, float]]]:
    return [(a, (4.0, 1.0)), (b, (3.0, -2.0))]


def test_a_start_connects_before_anything_is_solved() -> None:
    mapper = Mapper(ODOMETRY)
    mapper.configure("b", own(Start("map", (10.0, 2.0, 0.5), SPREAD)))
    mapper.apply("a", batch([Step(None, pair("p", "q"))]))
    mapper.apply("b", batch([Step(None, pair("r", "s"))]))
    mapper.apply("c", batch([Step(None, pair("t", "u"))]))
    view = mapper.view()
    found = view.pose("b")
    assert (found.x, found.y, found.theta) == pytest.approx((10.0, 2.0, 0.5))
    assert found.covariance == pytest.approx(np.array(SPREAD), abs=1e-6)
    with pytest.raises(NotConnected):
        view.pose("c")
    assert view.not_connected() == 2
    assert [one.id for one in view.landmarks()[0]] == ["p", "q", "r", "s"]


def test_a_start_in_a_submap_composes() -> None:
    mapper = Mapper(ODOMETRY)
    mapper.configure("b", own(Start("map", (10.0, 2.0, 0.5), SPREAD)))
    mapper.apply("a", batch([Step(None, pair("p", "q"))]))
    mapper.apply("b", batch([Step(None, pair("r", "s"))]))
    mapper.configure("c", own(Start("submap/1", (1.0, 0.0, 0.2), SPREAD)))
    mapper.apply("c", batch([Step(None, pair("t", "u"))]))
    before = mapper.view().pose("c")
    assert (before.x, before.y, before.theta) == pytest.approx(compose((10.0, 2.0, 0.5), (1.0, 0.0, 0.2)))
    mapper.install(join(mapper.problem()))
    now = mapper.view().pose("c")
    assert (now.x, now.y, now.theta) == pytest.approx((before.x, before.y, before.theta), abs=1e-9)
    # A robot that has not moved: frame and end differ by the floors alone, 1e13 beside 25.
    assert now.covariance == pytest.approx(before.covariance, rel=1e-3, abs=1e-6)
    assert [e.kind for e in mapper.view().edges()] == ["start", "start"]
    T, _, path = mapper.view().transform(0, 2)
    assert path == [0, 1, 2]
    assert pytest.approx((before.x, before.y, before.theta)) == T


def test_a_start_of_the_first_robot_says_where_map_is() -> None:
    mapper = Mapper(ODOMETRY)
    mapper.configure("a", own(Start("map", (5.0, 0.0, 1.0), SPREAD)))
    mapper.configure("b", own(Start("map", (5.0, 3.0, 1.0), SPREAD)))
    mapper.apply("a", batch([Step(None, pair("p", "q")), Step((1.0, 0.0, 0.0), pair("p", "q"))]))
    mapper.apply("b", batch([Step(None, pair("r", "s"))]))
    mapper.install(join(mapper.problem()))
    first = mapper.view().submap(0)
    assert first.pose == pytest.approx((5.0, 0.0, 1.0))
    assert first.covariance == pytest.approx(np.array(SPREAD), abs=1e-6)
    T, covariance, _ = mapper.view().transform(0, 1)
    assert pytest.approx(compose(inverse((5.0, 0.0, 1.0)), (5.0, 3.0, 1.0))) == T
    assert covariance[2, 2] == pytest.approx(0.02)


def test_a_start_counts_once() -> None:
    """With landmarks in common, the start is one more measurement of the joint problem: both agree."""
    mapper = Mapper(ODOMETRY)
    mapper.configure("b", own(Start("map", (1.0, 1.0, 0.0), SPREAD)))
    mapper.apply("a", batch([Step(None, pair("p", "q"))]))
    mapper.apply("b", batch([Step(None, [("p", (3.1, 0.0)), ("q", (2.0, -3.0))])]))
    alone = mapper.view().pose("b").covariance
    mapper.install(join(mapper.problem()))
    together = mapper.view().pose("b").covariance
    mapper.apply("b", batch([Step(None)], start=1.0))  # the view goes on from the solution
    assert np.all(np.linalg.eigvalsh(alone - together) > 0.0)
    assert mapper.view().pose("b").covariance == pytest.approx(together, rel=1e-6)


def test_landmarks_that_two_components_share_are_still_one_each() -> None:
    """Until they meet, a landmark of both is answered from map's component."""
    mapper = Mapper(ODOMETRY)
    mapper.apply("a", batch([Step(None, pair("p", "q"))]))
    mapper.apply("b", batch([Step(None, [("p", (0.0, 5.0)), ("x", (1.0, 1.0))])]))
    mapper.install(join(mapper.problem()))
    view: View = mapper.view()
    one = view.landmark("p")
    assert (one.x, one.y) == pytest.approx((4.0, 1.0))
    assert one.submaps == (0, 1)
    assert view.not_connected() == 1
    state: AtlasState = view.state
    assert state.roots == [0, 1]


def test_robots_of_one_map_keep_their_models() -> None:
    mapper = Mapper(ODOMETRY)
    fine = RobotConfig(ODOMETRY.motion, ObservationConfig("range_bearing", (0.01, 0.01)))
    mapper.configure("b", fine)
    mapper.apply("a", batch([Step(None, [("p", (3.0, 4.0))])]))
    mapper.apply("b", batch([Step(None, [("q", (5.0, 0.0))])]))
    view = mapper.view()
    a, b = view.local_landmarks(0)[0], view.local_landmarks(1)[0]
    assert (b.x, b.y) == pytest.approx((5.0, 0.0))
    assert np.trace(b.covariance) < np.trace(a.covariance)
