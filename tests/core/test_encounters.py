"""Robots that see one another: marks, late and early, and the ties that they make."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from submaps.atlas.joining import join
from submaps.config import MapConfig, MotionConfig, ObservationConfig
from submaps.consistency import average_bounds
from submaps.encounters import Columns, with_marks
from submaps.geometry.se2 import between
from submaps.geometry.space import PLANE, SOLID, Pose, Space
from submaps.mapper import Mapper
from submaps.measurements import Batch, as_encounter, encounter
from submaps.simulation import Run, World, drive
from tests.core.support import R, Step, batch, cut, random_covariance, wrapped

Floats = NDArray[np.float64]
SIGMA_V, SIGMA_W, SIGMA_Z = 0.05, float(np.deg2rad(1.0)), 0.15
CONFIG = MapConfig(MotionConfig("velocity", (SIGMA_V, SIGMA_W)), ObservationConfig("cartesian", (SIGMA_Z, SIGMA_Z)))


def test_a_name_comes_back() -> None:
    assert as_encounter(encounter("r2", 0.1)) == ("r2", 0.1)
    assert as_encounter("r2") is None


# -- marks among columns -------------------------------------------------------------------------


def columns(seed: int, steps: int = 4, space: Space = PLANE) -> Columns:
    rng, d = np.random.default_rng(seed), space.dim
    noises = np.array([random_covariance(rng, space.pose, 0.02) for _ in range(steps)])
    seen = np.sort(rng.integers(0, steps, 5))
    return Columns(
        t=np.arange(1.0, steps + 1.0), control_step=np.arange(steps),
        increments=rng.normal(size=(steps, space.pose)) * 0.3, noises=noises,
        observation_step=seen, landmark=np.arange(5), z=rng.normal(size=(d, 5)),
        R=0.01 * np.eye(d)[np.newaxis], own=np.zeros(5, dtype=np.uint8),
    )  # fmt: skip


def reckoned(c: Columns, space: Space) -> tuple[Pose, Floats]:
    """All increments composed."""
    pose, noise = space.origin, np.zeros((space.pose, space.pose))
    for increment, own in zip(c.increments, c.noises, strict=True):
        noise = space.compose_covariance(pose, noise, space.as_pose(increment), own)
        pose = space.compose(pose, space.as_pose(increment))
    return pose, noise


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 1000), st.lists(st.floats(0.0, 5.0), min_size=1, max_size=6), st.sampled_from([PLANE, SOLID]))
def test_marks_leave_everything_else_as_it_was(seed: int, times: list[float], space: Space) -> None:
    c = columns(seed, space=space)
    marks = [(t, 10 + i) for i, t in enumerate(times) if t <= 4.0]
    made = with_marks(c, 0.0, marks)
    assert np.array_equal(made.columns.t[made.steps], c.t)
    assert np.all(np.diff(made.columns.t) > 0.0)
    back = made.observations
    assert np.array_equal(made.columns.landmark[back], c.landmark)
    assert np.array_equal(made.columns.z[:, back], c.z)
    assert np.array_equal(made.columns.observation_step[back], made.steps[c.observation_step])
    assert np.all(np.diff(made.columns.observation_step) >= 0)
    own = made.columns.own > 0
    expected = sorted((t, n) for t, n in marks if t >= 0.0)
    times_ = made.columns.t[made.columns.observation_step[own]].tolist()
    assert sorted(zip(times_, made.columns.landmark[own].tolist(), strict=True)) == expected


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 1000), st.floats(0.05, 0.95), st.sampled_from([PLANE, SOLID]))
def test_a_control_in_two_parts_moves_as_far(seed: int, part: float, space: Space) -> None:
    c = columns(seed, space=space)
    made = with_marks(c, 0.0, [(2.0 + part, 9)]).columns
    pose, noise = reckoned(c, space)
    again, spread = reckoned(made, space)
    assert again == pytest.approx(pose, abs=1e-12)
    # The noise of one part turns with the rotation's error of the other: second order in the increment.
    assert np.linalg.norm(spread - noise) < 0.2 * np.linalg.norm(noise)
    turned = slice(space.dim, space.pose)
    assert spread[turned, turned] == pytest.approx(noise[turned, turned], abs=1e-12)


def test_nothing_is_marked_before_the_first_step() -> None:
    made = with_marks(columns(1), None, [(0.5, 9), (1.0, 10)])
    assert made.columns.landmark[made.columns.own > 0].tolist() == [10]


# -- two robots with nothing in common but each other -------------------------------------------


def world(seed: int, offset: float = 0.0, steps: int = 400) -> tuple[dict[str, Batch], dict[str, Run]]:
    """Robot a sees robot b now and then; their landmarks are each its own; b's steps lie ``offset`` later."""
    rng = np.random.default_rng(seed)
    turn = 0.1 * np.cos(0.02 * np.arange(steps))
    runs = {}
    for name, start, sign, low in (("a", (0.0, 0.0, 0.0), 1.0, -12.0), ("b", (3.0, 5.0, 0.3), -1.0, 8.0)):
        landmarks = np.stack([rng.uniform(-5.0, 30.0, 30), rng.uniform(low, low + 8.0, 30)], axis=1)
        velocity = np.stack([np.full(steps, 0.5), sign * turn], axis=1)
        runs[name] = drive(World(landmarks, velocity, 0.1, 9.0, 5, (SIGMA_V, SIGMA_W), SIGMA_Z, start), rng)
    batches = {name: replace(r.batch, landmark=tuple(name + i for i in r.batch.landmark)) for name, r in runs.items()}
    batches["b"] = replace(batches["b"], t=batches["b"].t + offset)
    seen = []
    for k in range(40, steps, 23):
        i, part = int(np.floor(k - offset / 0.1)), (-offset / 0.1) % 1.0
        there = (1.0 - part) * runs["b"].poses[i] + part * runs["b"].poses[i + 1]
        x, y, theta = runs["a"].poses[k]
        z = R(theta).T @ (there[:2] - (x, y)) + rng.normal(size=2) * SIGMA_Z
        seen.append((k, encounter("b", float(batches["a"].t[k])), z))
    batches["a"] = _with(batches["a"], seen)
    return batches, runs


def _with(b: Batch, seen: list[tuple[int, str, Floats]]) -> Batch:
    step = np.concatenate([b.observation_step, [k for k, _, _ in seen]]).astype(np.int64)
    order = np.argsort(step, kind="stable")
    names = [*b.landmark, *(name for _, name, _ in seen)]
    z = np.concatenate([b.z, np.array([z for _, _, z in seen]).T], axis=1)
    return replace(
        b, observation_step=step[order], landmark=tuple(names[i] for i in order), z=np.ascontiguousarray(z[:, order])
    )


def mapped(batches: dict[str, Batch], order: str, chunk: int) -> tuple[Mapper, int]:
    """Both robots' batches taken in turn; how many sightings came too late."""
    mapper, late = Mapper(CONFIG), 0
    steps = batches["a"].steps
    for begin in range(0, steps, chunk):
        for name in order:
            report = mapper.apply(name, cut(batches[name], begin, min(begin + chunk, steps)))
            late += sum(one.reason == "late" for one in report.rejected)
        if mapper.solve_due:
            mapper.install(join(mapper.problem()))
    mapper.install(join(mapper.problem()))
    return mapper, late


def score(mapper: Mapper, runs: dict[str, Run], order: str) -> float:
    """NEES per degree of freedom of the second robot's pose in the first one's frame."""
    first, second = order[0], order[1]
    found = mapper.view().pose(second)
    true = between(tuple(runs[first].poses[0]), tuple(runs[second].poses[-1]))
    error = np.array([found.x - true[0], found.y - true[1], wrapped(found.theta - true[2])])
    return float(error @ np.linalg.solve(found.covariance, error)) / 3.0


@pytest.mark.parametrize("order", ["ab", "ba"])
@pytest.mark.parametrize("offset", [0.0, 0.03])
def test_sightings_alone_tie_robots_consistently(order: str, offset: float) -> None:
    scores = []
    for seed in range(30):
        batches, runs = world(seed, offset)
        mapper, _ = mapped(batches, order, 10)
        assert mapper.view().connected(1)
        scores.append(score(mapper, runs, order))
    low, high = average_bounds(0.99, 3, 30)
    assert low < np.mean(scores) < high


def test_a_sighting_told_late_is_as_good_as_one_told_early() -> None:
    batches, _ = world(3)
    early, none = mapped(batches, "ab", 5)
    late, few = mapped(batches, "ba", 5)  # b is always ahead of what a tells of it
    assert none == 0
    assert few <= 2  # where b's sub-map had closed in between
    a, b = early.view().pose("b", "odom"), late.view().pose("b", "odom")
    assert (a.x, a.y, a.theta) == (b.x, b.y, b.theta)
    there, here = early.view(), late.view()
    for k, other in zip(there.state.chain(1), here.state.chain(0), strict=True):
        same = [i for i in k.landmarks if there.state.names[i] in here.state.number_of]
        shared = [(k.slot_of(i), here.state.number_of[there.state.names[i]]) for i in same]
        for slot, number in shared:
            if other.holds(number):
                at = other.slot_of(number)
                assert k.mean[slot : slot + 2] == pytest.approx(other.mean[at : at + 2], abs=1e-9)
        assert k.mean[:3] == pytest.approx(other.mean[:3], abs=1e-9)
        assert (k.steps, k.observations) == (other.steps, other.observations)


def test_a_sighting_of_long_ago_is_told_to_be_late() -> None:
    mapper = Mapper(CONFIG)
    mapper.apply("a", batch([Step(None)]))
    mapper.apply("b", batch([Step(None, [("p", (1.0, 0.0))])]))
    mapper.apply("b", batch([Step((1.0, 0.0), [("p", (0.9, 0.0))])], start=1.0))
    report = mapper.apply("a", batch([Step(None, [(encounter("b", -5.0), (2.0, 0.0)), ("q", (1.0, 1.0))])], start=2.0))
    assert [(one.reason, one.landmark) for one in report.rejected] == [("late", encounter("b", -5.0))]
    assert mapper.view().counts()["landmarks"] == 2
    assert [one.id for one in mapper.view().local_landmarks(0)] == ["q"]


def test_a_sighting_of_a_robot_that_never_comes_ties_nothing() -> None:
    mapper = Mapper(CONFIG)
    mapper.apply("a", batch([Step(None, [(encounter("ghost", 0.0), (2.0, 0.0)), ("q", (1.0, 1.0))])]))
    mapper.install(join(mapper.problem()))
    view = mapper.view()
    assert [one.id for one in view.landmarks()[0]] == ["q"]
    assert view.counts()["landmarks"] == 1


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 1000), st.integers(0, 3), st.booleans())
def test_columns_cut_and_joined_keep_what_each_says(seed: int, step: int, each: bool) -> None:
    c = columns(seed)
    if each:
        c = replace(c, R=np.random.default_rng(seed).normal(size=(5, 2, 2)))
    later = c.since(step)
    assert later.t.tolist() == c.t[step:].tolist()
    assert later.control_step.tolist() == list(range(1, 4 - step))
    assert np.array_equal(later.each, c.each[c.observation_step >= step])
    one = later.only(np.arange(later.landmark.shape[0]) == 0)
    both = one.then(later)
    assert np.array_equal(both.each, np.concatenate([one.each, later.each]))
    assert np.array_equal(both.landmark, np.concatenate([one.landmark, later.landmark]))
    marked = with_marks(one, None, [(float(one.t[-1]), 99)])
    assert np.array_equal(marked.columns.each[marked.observations], one.each)
