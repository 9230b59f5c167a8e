"""Laws of the main path: chunking, genesis rule by rule, and that no measurement counts twice."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from submaps.config import MapConfig, MotionConfig, ObservationConfig
from submaps.errors import NotConnected, UnknownName
from submaps.mapper import Mapper
from submaps.measurements import Batch, Report
from submaps.submap import Submap
from tests.core.support import ODOMETRY, Step, after, batch, cut, laps

STEPPING = (0.5, 0.0, 0.02)


def lay(config: MapConfig, whole: Batch, size: int) -> tuple[Mapper, list[Report]]:
    """A whole drive in batches of ``size`` steps."""
    mapper = Mapper(config)
    reports = [mapper.apply("a", cut(whole, k, min(k + size, whole.steps))) for k in range(0, whole.steps, size)]
    return mapper, reports


def submaps(mapper: Mapper) -> list[Submap]:
    return list(mapper.view().state.submaps())


def wide(**changes: object) -> MapConfig:
    """A configuration in which nothing but what is changed begins a sub-map."""
    apart = {"max_landmarks": 1000, "max_heading_sigma": 100.0, "max_position_sigma": 1e6, "min_observed_steps": 1}
    return replace(ODOMETRY, **(apart | changes))  # type: ignore[arg-type]


@pytest.mark.parametrize("filter_name", ["invariant", "standard"])
def test_how_a_drive_is_cut_into_batches_changes_nothing(filter_name: str) -> None:
    config = replace(ODOMETRY, max_landmarks=8, filter=filter_name)  # type: ignore[arg-type]
    whole = laps(20, seed=1)
    reference, reports = lay(config, whole, whole.steps)
    for size in (1, 7):
        mapper, parts = lay(config, whole, size)
        assert len(submaps(mapper)) == len(submaps(reference)) > 3
        for a, b in zip(submaps(mapper), submaps(reference), strict=True):
            assert np.array_equal(a.landmarks, b.landmarks)
            assert np.allclose(a.mean, b.mean, rtol=0.0, atol=1e-9)
            assert np.allclose(a.packed, b.packed, rtol=1e-9, atol=1e-15)
            assert (a.steps, a.observations, a.observed_steps) == (b.steps, b.observations, b.observed_steps)
        assert np.array_equal(np.concatenate([p.track_submap for p in parts]), reports[0].track_submap)
        assert np.allclose(np.concatenate([p.track_pose for p in parts]), reports[0].track_pose, atol=1e-9)
        assert np.allclose(mapper.view().pose("a", "odom").covariance, reference.view().pose("a", "odom").covariance)


def test_a_view_in_between_changes_nothing() -> None:
    whole = laps(20, seed=2)
    config = replace(ODOMETRY, max_landmarks=8)
    quiet, _ = lay(config, whole, 7)
    asked = Mapper(config)
    for k in range(0, whole.steps, 7):
        asked.view()
        asked.apply("a", cut(whole, k, min(k + 7, whole.steps)))
        asked.view().pose("a")
    assert [s.digest() for s in submaps(asked)] == [s.digest() for s in submaps(quiet)]


def test_a_view_never_changes() -> None:
    whole = laps(20, seed=3)
    mapper = Mapper(replace(ODOMETRY, max_landmarks=8))
    mapper.apply("a", cut(whole, 0, 30))
    view = mapper.view()
    before = (view.counts(), [s.digest() for s in view.state.submaps()], view.pose("a"), list(view.landmark_ids()))
    mapper.apply("a", cut(whole, 30, whole.steps))
    now = (view.counts(), [s.digest() for s in view.state.submaps()], view.pose("a"), list(view.landmark_ids()))
    assert before[0] == now[0]
    assert before[1] == now[1]
    assert (before[2].x, before[2].y, before[2].theta) == (now[2].x, now[2].y, now[2].theta)
    assert before[3] == now[3]


# -- genesis -----------------------------------------------------------------------------------


def points(first: int, count: int) -> list[tuple[str, tuple[float, float]]]:
    return [(f"p{i}", (3.0 + i, 1.0)) for i in range(first, first + count)]


def test_a_submap_closes_before_it_overflows() -> None:
    steps = [Step(None, points(0, 2)), Step(STEPPING, points(2, 2)), Step(STEPPING, points(4, 1))]
    steps += [Step(STEPPING, points(0, 5))]  # seen before: no room is needed
    mapper = Mapper(wide(max_landmarks=5))
    mapper.apply("a", batch(steps))
    assert [list(s.landmarks) for s in submaps(mapper)] == [[0, 1, 2, 3, 4]]
    mapper.apply("a", batch([Step(STEPPING, points(4, 2))], start=1.0))
    assert [list(s.landmarks) for s in submaps(mapper)] == [[0, 1, 2, 3, 4], [4, 5]]


def test_a_step_may_overfill_an_empty_submap() -> None:
    mapper = Mapper(wide(max_landmarks=3))
    mapper.apply("a", batch([Step(None, points(0, 5)), Step(STEPPING, points(5, 4)), Step(STEPPING, points(6, 1))]))
    assert [list(s.landmarks) for s in submaps(mapper)] == [[0, 1, 2, 3, 4], [5, 6, 7, 8]]


def test_an_overfull_submap_stays_while_nothing_new_comes() -> None:
    for control in (STEPPING, (0.0, 0.0, 0.0)):
        mapper = Mapper(wide(max_landmarks=2))
        mapper.apply("a", batch([Step(None, points(0, 5)), *(Step(control, points(0, 5)) for _ in range(5))]))
        assert [len(s.landmarks) for s in submaps(mapper)] == [5]


def test_arrays_grow_for_a_step_that_is_larger_than_they_are() -> None:
    """400 landmarks at once, then as many updates: as if there had been room from the beginning."""
    many = [(f"p{i}", (10.0 + 0.1 * i, float(i % 7))) for i in range(400)]
    split = Mapper(wide())
    split.apply("a", batch([Step(None, many[:20]), Step(STEPPING, many), Step(STEPPING, many[100:])]))
    assert [len(s.landmarks) for s in submaps(split)] == [400]
    assert submaps(split)[0].observations == 20 + 400 + 300
    one = Mapper(wide())
    singly = [Step(STEPPING if k == 0 else None, [m]) for k, m in enumerate(many)]
    one.apply("a", batch([Step(None, many[:20]), *singly]))
    assert np.array_equal(submaps(one)[0].landmarks, submaps(split)[0].landmarks)


def heading_sigma(s: Submap) -> float:
    return math.sqrt(s.packed[5])


def test_a_submap_closes_when_its_heading_has_become_unsure() -> None:
    config = wide(max_heading_sigma=0.010)
    # One landmark at the sensor's foot says little of the heading: 0.004 rad a step.
    steps = [Step(None if k == 0 else STEPPING, [(f"p{k}", (0.1, 0.0))]) for k in range(30)]
    mapper = Mapper(config)
    report = mapper.apply("a", batch(steps))
    closed = submaps(mapper)[:-1]
    assert len(closed) > 2
    # 6 steps without news: 0.004 * sqrt(6) < 0.010 < 0.004 * sqrt(7)
    assert [int(np.sum(report.track_submap == s.number)) for s in closed] == [7] * len(closed)
    assert all(heading_sigma(s) == pytest.approx(0.004 * math.sqrt(7), rel=1e-9) for s in closed)


def test_an_unsure_submap_stays_until_it_holds_enough_observed_steps() -> None:
    steps = [Step(None if k == 0 else STEPPING, [(f"p{k}", (0.1, 0.0))] if k % 2 == 0 else []) for k in range(40)]
    mapper = Mapper(wide(max_heading_sigma=0.010, min_observed_steps=6))
    mapper.apply("a", batch(steps))
    closed = submaps(mapper)[:-1]
    assert len(closed) > 1
    assert all(s.observed_steps == 6 for s in closed)
    assert all(s.steps > s.observed_steps for s in closed)


def test_a_submap_closes_when_its_position_has_become_unsure() -> None:
    steps = [Step(None if k == 0 else STEPPING, [(f"p{k}", (5.0, 1.0))]) for k in range(40)]
    config = wide(max_position_sigma=0.06, motion=MotionConfig("odometry", (0.03, 0.01, 0.0)))
    mapper = Mapper(config)
    mapper.apply("a", batch(steps))
    closed = submaps(mapper)[:-1]
    assert len(closed) > 2
    # variance a step 0.001 m^2: 0.0036 is passed by the fourth
    assert all(s.steps == 4 for s in closed)
    for s in closed:
        assert s.packed[0] + s.packed[2] == pytest.approx(4 * 0.001, rel=1e-9)


def test_a_pose_without_variance_is_raised_to_the_floors() -> None:
    """A parked robot, and one that can slip neither forward nor sideways but by its heading."""
    parked = Mapper(wide())
    parked.apply("a", batch([Step(None, points(0, 2))]))
    (s,) = submaps(parked)
    assert np.allclose(s.covariance()[:3, :3], np.diag([1e-8, 1e-8, 4e-14]), rtol=1e-12, atol=0.0)
    turning = Mapper(wide(motion=MotionConfig("odometry", (0.0, 0.0, 0.01))))
    turning.apply("a", batch([Step(None, points(0, 2)), Step((1.0, 0.0, 0.0)), Step((1.0, 0.0, 0.0))]))
    (s,) = submaps(turning)
    assert np.linalg.eigvalsh(s.covariance()[:3, :3])[0] > 1e-10
    assert s.packed[5] == pytest.approx(2e-4, rel=1e-9)


@pytest.mark.parametrize("filter_name", ["invariant", "standard"])
def test_the_position_is_judged_by_its_additive_error(filter_name: str) -> None:
    """Far from the origin the invariant error's own position part means something else."""
    steps = [Step(None if k == 0 else (3.0, 0.0, 0.0), [(f"p{k}", (5.0, 1.0))]) for k in range(30)]
    config = wide(
        max_position_sigma=0.5, filter=filter_name, motion=MotionConfig("odometry", (1e-3, 1e-3, 0.01)),
    )  # fmt: skip
    mapper = Mapper(config)
    report = mapper.apply("a", batch(steps))
    # sigma_y = 3 m * 0.01 * sqrt(1 + 4 + ... + (k - 1)^2) passes 0.5 m at k = 10: sqrt(285) = 16.9.
    assert [int(np.sum(report.track_submap == k)) for k in (0, 1)] == [10, 10]


def test_no_submap_begins_while_the_robot_stands_still() -> None:
    config = wide(max_heading_sigma=0.010, max_landmarks=4, motion=MotionConfig("odometry", (0.0, 0.0, 0.02)))
    still = (0.0, 0.0, 0.0)
    steps = [Step(None, points(0, 1)), *(Step(still, points(k, 1)) for k in range(1, 8))]
    mapper = Mapper(config)
    mapper.apply("a", batch(steps))
    assert [len(s.landmarks) for s in submaps(mapper)] == [8]  # bounded by twice as many
    mapper.apply("a", batch([Step(still, points(9, 1))], start=1.0))
    assert [len(s.landmarks) for s in submaps(mapper)] == [8, 1]
    moving = Mapper(config)
    moving.apply("a", batch([Step(None, points(0, 1)), Step((0.1, 0.0, 0.0), points(1, 1))]))
    assert len(submaps(moving)) == 2


def test_a_small_shelf_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """A walk that has to come back for room reaches the same bits."""
    config = wide(max_landmarks=4, motion=MotionConfig("odometry", (0.05, 0.05, 0.02)))
    steps = [Step(None if k == 0 else STEPPING, points(3 * k, 3)) for k in range(40)]
    one = Mapper(config)
    monkeypatch.setattr("submaps.mapper._SHELF_SUBMAPS", 3)
    monkeypatch.setattr("submaps.mapper._SHELF_REALS", 8)  # less than one sub-map: it has to grow, too
    two = Mapper(config)
    reports = [mapper.apply("a", batch(steps)) for mapper in (one, two)]
    assert len(submaps(one)) > 30
    assert one.problem().digest() == two.problem().digest()
    assert np.array_equal(reports[0].track_submap, reports[1].track_submap)


def test_steps_without_observations_begin_nothing() -> None:
    mapper = Mapper(wide(max_heading_sigma=0.001))
    mapper.apply("a", batch([Step(None, points(0, 1)), *(Step(STEPPING) for _ in range(50))]))
    assert len(submaps(mapper)) == 1
    mapper.apply("a", batch([Step(STEPPING, points(1, 1))], start=10.0))
    assert len(submaps(mapper)) == 2


# -- nothing counts twice ----------------------------------------------------------------------


def test_every_measurement_enters_exactly_one_submap() -> None:
    whole = laps(20, seed=4)
    mapper, reports = lay(replace(ODOMETRY, max_landmarks=6, gate=0.9), whole, 11)
    held = submaps(mapper)
    rejected = sum(len(r.rejected) for r in reports)
    assert len(held) > 4
    assert rejected > 0
    assert sum(s.steps for s in held) == whole.steps
    assert sum(s.rejected for s in held) == rejected
    assert sum(s.observations for s in held) == whole.observations - rejected
    assert sum(s.nis_count + len(s.landmarks) for s in held) == whole.observations - rejected
    assert sum(s.observed_steps for s in held) == np.unique(whole.observation_step).shape[0]
    counts = mapper.view().counts()
    assert (counts["steps"], counts["observations"], counts["rejected"]) == (
        whole.steps, whole.observations - rejected, rejected,
    )  # fmt: skip
    assert (counts["submaps"], counts["landmarks"], counts["robots"]) == (len(held), 20, 1)


def test_the_increment_into_the_last_pose_belongs_to_the_submap_that_closes() -> None:
    """With heading known and no landmark seen twice the exits' variances are sums of steps."""
    config = wide(max_landmarks=3, motion=MotionConfig("odometry", (0.02, 0.01, 0.0)))
    steps = [Step(None if k == 0 else (1.0, 0.0, 0.0), [(f"p{k}", (2.0, 0.0))]) for k in range(13)]
    mapper = Mapper(config)
    mapper.apply("a", batch(steps))
    held = submaps(mapper)
    assert [s.pose for s in held[:-1]] == [(3.0, 0.0, 0.0)] * 4
    for s in held[:-1]:
        assert s.packed[[0, 2]] == pytest.approx([3 * 4e-4, 3 * 1e-4], rel=1e-9)
    assert held[-1].pose == (0.0, 0.0, 0.0)


def test_exits_chain_the_frames() -> None:
    whole = laps(20, seed=5, noise=0.0)
    mapper, reports = lay(replace(ODOMETRY, max_landmarks=6), whole, 13)
    held = submaps(mapper)
    assert [s.previous for s in held] == [-1, *range(len(held) - 1)]
    assert [s.following for s in held] == [*range(1, len(held)), -1]
    assert [s.active for s in held] == [False] * (len(held) - 1) + [True]
    for one, other in pairwise(held):
        assert one.ended == other.began
    view = mapper.view()
    odom, end = view.pose("a", "odom"), view.pose("a", "submap/0")
    assert (end.x, end.y) == pytest.approx((odom.x, odom.y), abs=1e-9)
    assert math.remainder(end.theta - odom.theta, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-11)
    assert reports[-1].pose == pytest.approx(held[-1].pose, abs=1e-12)


def test_dead_reckoning_is_tracked_from_batch_to_batch() -> None:
    whole = laps(20, seed=9)
    mapper, reports = lay(ODOMETRY, whole, 13)
    track = np.concatenate([r.track_odom for r in reports])
    assert track.shape == (whole.steps, 3)
    assert np.array_equal(track[0], np.zeros(3))
    odom = mapper.view().pose("a", "odom")
    assert tuple(track[-1]) == (odom.x, odom.y, odom.theta)
    pose = np.zeros(3)
    for k in range(1, whole.steps):
        pose = after(pose, whole.control[:, k - 1])
        assert np.allclose(track[k, :2], pose[:2], atol=1e-9)


def test_the_track_lies_in_the_submap_that_it_names() -> None:
    """A step that begins a sub-map stands at its origin."""
    whole = laps(20, seed=6)
    mapper, reports = lay(replace(ODOMETRY, max_landmarks=6), whole, whole.steps)
    track, number = reports[0].track_pose, reports[0].track_submap
    firsts = np.flatnonzero(np.diff(number)) + 1
    assert np.array_equal(number[firsts], np.arange(1, number[-1] + 1))
    assert np.abs(track[firsts]).max() < 0.5  # corrected by what was seen there, but hardly moved
    exits = np.array([s.pose for s in submaps(mapper)[:-1]])
    assert np.all(np.hypot(exits[:, 0], exits[:, 1]) > 1.0)


def test_a_landmark_twice_in_one_step_is_seen_twice() -> None:
    twice = [("p", (3.0, 1.0)), ("q", (5.0, 0.0)), ("p", (3.2, 1.0))]
    mapper = Mapper(wide(max_landmarks=2))
    report = mapper.apply("a", batch([Step(None, twice)]))
    s = submaps(mapper)[0]
    assert list(s.landmarks) == [0, 1]
    assert s.observations == 3
    assert s.mean[3:5] == pytest.approx((3.1, 1.0))
    assert s.covariance()[3, 3] == pytest.approx(0.01 / 2, rel=1e-9)
    assert not report.rejected
    # Room is counted once for each landmark, too.
    mapper.apply("a", batch([Step(STEPPING, [("r", (1.0, 1.0)), ("r", (1.0, 1.1))])], start=1.0))
    mapper.apply("a", batch([Step(STEPPING, [("s", (1.0, 1.0)), ("r", (1.0, 1.1)), ("s", (1.0, 1.1))])], start=2.0))
    assert [list(s.landmarks) for s in submaps(mapper)] == [[0, 1], [2, 3]]


def test_what_is_set_aside_names_its_place() -> None:
    mapper = Mapper(replace(ODOMETRY, gate=0.99))
    far = [("p0", (3.0, 1.0)), ("p1", (14.0, 1.0)), ("p2", (5.0, 1.0))]
    report = mapper.apply("a", batch([Step(None, points(0, 3)), Step(None), Step(None, far)]))
    assert [(r.step, r.observation, r.landmark, r.reason) for r in report.rejected] == [(2, 1, "p1", "gate")]
    assert report.rejected[0].nis == pytest.approx(100.0 / 0.02, rel=1e-9)
    assert not report.flagged
    open_gate = Mapper(ODOMETRY).apply("a", batch([Step(None, points(0, 3)), Step(None), Step(None, far)]))
    assert not open_gate.rejected
    assert [(r.step, r.observation, r.landmark) for r in open_gate.flagged] == [(2, 1, "p1")]


def test_a_bearing_to_a_landmark_underfoot_is_rejected_as_singular() -> None:
    config = replace(wide(), observation=ObservationConfig("range_bearing", (0.1, 0.01)))
    mapper = Mapper(config)
    report = mapper.apply("a", batch([Step(None, [("p", (2.0, 0.0))]), Step((2.0, 0.0, 0.0), [("p", (0.1, 1.0))])]))
    assert [(r.step, r.landmark, r.reason, r.nis) for r in report.rejected] == [(1, "p", "singular", None)]
    assert np.isfinite(submaps(mapper)[0].packed).all()


# -- several robots ----------------------------------------------------------------------------


def test_robots_that_never_meet_keep_apart() -> None:
    whole = laps(20, seed=7)
    other = replace(laps(20, seed=8), landmark=tuple("x" + name for name in laps(20, seed=8).landmark))
    config = replace(ODOMETRY, max_landmarks=8)
    alone, _ = lay(config, whole, 9)
    mapper = Mapper(config)
    for k in range(0, whole.steps, 9):
        mapper.apply("a", cut(whole, k, min(k + 9, whole.steps)))
        mapper.apply("b", cut(other, k, min(k + 9, other.steps)))
    view = mapper.view()
    own = view.state.chain(0)
    assert [s.mean.tolist() for s in own] == [s.mean.tolist() for s in alone.view().state.chain(0)]
    assert {r.id: r.number for r in view.robots()} == {"a": 0, "b": 1}
    with pytest.raises(NotConnected):
        view.pose("b", "map")
    with pytest.raises(NotConnected):
        view.landmark(other.landmark[0], "map")
    first_of_b, last_of_b = view.state.chain(1)[0].number, view.state.chain(1)[-1].number
    with pytest.raises(NotConnected):
        view.transform(0, first_of_b)
    assert view.pose("b", f"submap/{last_of_b}").kind == "filtered"
    assert view.pose("b", f"submap/{first_of_b}").kind == "path"
    assert view.submap(last_of_b).pose is None
    found, _ = view.landmarks(limit=1000)
    assert {one.id for one in found} == set(whole.landmark)


def test_names_that_do_not_exist() -> None:
    mapper = Mapper(ODOMETRY)
    mapper.apply("a", batch([Step(None, points(0, 1))]))
    view = mapper.view()
    with pytest.raises(UnknownName):
        view.pose("b")
    with pytest.raises(UnknownName):
        view.landmark("never")
    with pytest.raises(UnknownName):
        view.pose("a", "submap/1")
    with pytest.raises(UnknownName):
        view.pose("a", "nowhere")


def test_a_control_at_the_end_of_the_numbers_leaves_other_robots_alone() -> None:
    mapper = Mapper(ODOMETRY)
    mapper.apply("a", batch([Step(None, points(0, 2))]))
    before = submaps(mapper)[0].digest()
    mapper.apply("b", batch([Step((1e300, 0.0, 1e300), points(10, 2))]))
    assert submaps(mapper)[0].digest() == before
