"""Errors of trajectories and of landmarks: laws, and agreement with evo on the same files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from evo.core import metrics, sync
from evo.core.trajectory import PoseTrajectory3D
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from service.datasets import DatasetError, read_source
from service.datasets.tum import read_tum
from submaps.alignment import Alignment
from submaps.evaluation import (
    NothingInCommon,
    Statistics,
    Unit,
    absolute_error,
    associate,
    point_error,
    pose_nees,
    relative_error,
)
from submaps.trajectory import Trajectory, wrapped

Floats = NDArray[np.float64]
UNITS: dict[Unit, metrics.Unit] = {"frames": metrics.Unit.frames, "meters": metrics.Unit.meters}


def wander(seed: int, count: int = 400, dt: float = 0.1) -> Trajectory:
    """A drive in bends."""
    random = np.random.default_rng(seed)
    heading = np.cumsum(0.1 * random.normal(size=count))
    way = 0.1 * np.column_stack([np.cos(heading), np.sin(heading)])
    return Trajectory(
        dt * np.arange(count, dtype=np.float64), np.column_stack([np.cumsum(way, axis=0), wrapped(heading)])
    )


def perturbed(track: Trajectory, seed: int, shift: float = 0.003) -> Trajectory:
    """Another trajectory near one: poses off, times off, some missing, all of it in another frame."""
    random = np.random.default_rng(seed)
    kept = np.sort(random.permutation(len(track))[: int(0.7 * len(track))])
    poses = track.poses[kept] + random.normal(size=(len(kept), 3)) * (0.05, 0.05, 0.02)
    c, s = np.cos(0.7), np.sin(0.7)
    poses[:, :2] = poses[:, :2] @ np.array([[c, s], [-s, c]]) + (3.0, -2.0)
    poses[:, 2] = wrapped(poses[:, 2] + 0.7)
    return Trajectory(track.t[kept] + random.uniform(-shift, shift, len(kept)), poses)


def as_tum(track: Trajectory, path: Path) -> Path:
    rows = zip(track.t.tolist(), track.poses.tolist(), strict=True)
    path.write_text("".join(
        f"{t!r} {x!r} {y!r} 0 0 0 {float(np.sin(a / 2))!r} {float(np.cos(a / 2))!r}\n" for t, (x, y, a) in rows
    ))  # fmt: skip
    return path


def evo_trajectory(path: Path) -> PoseTrajectory3D:
    """A TUM file as evo holds it, whose quaternions begin with w."""
    rows = np.loadtxt(path)
    return PoseTrajectory3D(rows[:, 1:4], rows[:, [7, 4, 5, 6]], rows[:, 0])


def agree(ours: Statistics, theirs: metrics.PE) -> None:
    told = theirs.get_all_statistics()
    for name in ("rmse", "mean", "median", "max"):
        assert getattr(ours, name) == pytest.approx(told[name], abs=1e-9)
    assert ours.count == len(theirs.error)


def compare_with_evo(estimate: Path, truth: Path, most: float) -> Statistics:
    """Every number that both give, on the same two files."""
    own, true = associate(read_tum(estimate), read_tum(truth), most)
    theirs = [evo_trajectory(path) for path in (truth, estimate)]
    reference, found = sync.associate_trajectories(*theirs, max_diff=most)
    np.testing.assert_array_equal(own.t, found.timestamps)
    np.testing.assert_array_equal(true.t, reference.timestamps)
    for delta, unit in ((1.0, "frames"), (7.0, "frames"), (0.5, "meters"), (3.0, "meters")):
        relative, turn = relative_error(own, true, delta, "frames" if unit == "frames" else "meters")
        for ours, relation in ((relative, "translation_part"), (turn, "rotation_angle_rad")):
            error = metrics.RPE(metrics.PoseRelation[relation], delta, metrics.Unit[unit], all_pairs=False)
            error.process_data((reference, found))
            agree(ours, error)
    error = metrics.APE(metrics.PoseRelation.translation_part)
    error.process_data((reference, found))
    agree(absolute_error(own, true, aligned=False), error)
    found.align(reference)
    error = metrics.APE(metrics.PoseRelation.translation_part)
    error.process_data((reference, found))
    aligned = absolute_error(own, true)
    agree(aligned, error)
    return aligned


@pytest.mark.parametrize("seed", range(4))
def test_numbers_are_those_of_evo(seed: int, tmp_path: Path) -> None:
    truth = wander(seed)
    other = perturbed(truth, seed + 10)
    found = compare_with_evo(as_tum(other, tmp_path / "estimate.tum"), as_tum(truth, tmp_path / "truth.tum"), 0.01)
    assert 0.05 < found.rmse < 0.09  # sigma 0.05 m in x and y
    compare_with_evo(as_tum(truth, tmp_path / "long.tum"), as_tum(other, tmp_path / "short.tum"), 0.002)


def test_numbers_are_those_of_evo_on_a_real_trajectory(data_dir: Path, tmp_path: Path) -> None:
    run = read_source(str(data_dir / "mrclam_7"))
    assert run.truth is not None
    truth = run.truth.trajectories["robot2"]
    truth = truth.take(np.arange(0, len(truth), 20))
    other = perturbed(truth, 5)
    compare_with_evo(as_tum(other, tmp_path / "estimate.tum"), as_tum(truth, tmp_path / "truth.tum"), 0.01)


# -- laws ----------------------------------------------------------------------------------------


def test_a_trajectory_has_no_error_against_itself_wherever_it_is_laid() -> None:
    track = wander(3)
    moved = Trajectory(track.t, track.poses.copy())
    c, s = np.cos(2.0), np.sin(2.0)
    moved.poses[:, :2] = moved.poses[:, :2] @ np.array([[c, s], [-s, c]]) + (100.0, 7.0)
    moved.poses[:, 2] += 2.0
    assert absolute_error(moved, track).max < 1e-9
    assert absolute_error(moved, track, aligned=False).max > 10.0
    relative, turn = relative_error(moved, track, 1.0)
    assert relative.max < 1e-9
    assert turn.max < 1e-9


def test_statistics_by_hand() -> None:
    assert Statistics.of(np.array([3.0, 4.0, 0.0])) == Statistics((25 / 3) ** 0.5, 7 / 3, 3.0, 4.0, 3)


@given(st.lists(st.integers(0, 50), min_size=1, max_size=20, unique=True), st.lists(
    st.integers(0, 50), min_size=1, max_size=20, unique=True), st.floats(0.0, 5.0))  # fmt: skip
def test_what_belongs_together_is_near_and_nearest(a: list[int], b: list[int], most: float) -> None:
    one, two = (Trajectory(np.array(sorted(t), dtype=np.float64), np.zeros((len(t), 3))) for t in (a, b))
    short, long = (one, two) if len(a) <= len(b) else (two, one)
    distances = np.abs(short.t[:, None] - long.t).min(axis=1)
    if not (distances <= most).any():
        with pytest.raises(NothingInCommon, match="no two poses"):
            associate(one, two, most)
        return
    own, true = associate(one, two, most)
    assert len(own) == len(true) == int((distances <= most).sum())
    np.testing.assert_allclose(np.abs(own.t - true.t), distances[distances <= most])


def test_pairs_too_far_apart_are_no_pairs() -> None:
    track = wander(1, count=5)
    with pytest.raises(NothingInCommon, match="no two poses lie 9 frames apart"):
        relative_error(track, track, 9, "frames")
    with pytest.raises(NothingInCommon, match="no two poses lie 5 meters apart"):
        relative_error(track, track, 5.0)


def test_nees_of_points_is_one_where_the_covariances_are_true() -> None:
    """Points of one covariance: the alignment takes 3 of 2n degrees of freedom, whatever frame they are in."""
    random = np.random.default_rng(7)
    n, runs = 12, 400
    truth = 5.0 * random.normal(size=(n, 2))
    c, s = np.cos(0.8), np.sin(0.8)
    found = []
    for _ in range(runs):
        points = truth + 0.01 * random.normal(size=(n, 2))
        there = points @ np.array([[c, s], [-s, c]]) + (4.0, 1.0)
        found.append(point_error(there, np.tile(1e-4 * np.eye(2), (n, 1, 1)), truth).nees)
    assert np.mean(found) == pytest.approx(1.0, abs=4.0 * (2.0 / ((2 * n - 3) * runs)) ** 0.5)


def test_nees_turns_with_the_alignment() -> None:
    """Errors along x in the map's frame, where the variance is large; the truth lies turned by a quarter."""
    random = np.random.default_rng(8)
    n = 2000
    covariance = np.diag([1.0, 1e-4, 1e-6])
    error = random.normal(size=(n, 3)) * np.sqrt(np.diagonal(covariance))
    pose = np.column_stack([10.0 * random.normal(size=(n, 2)), random.uniform(-3.0, 3.0, n)])
    quarter = Alignment((2.0, 3.0, np.pi / 2), 0.0, 0.0)
    truth = np.column_stack([quarter.apply(pose[:, :2]), wrapped(pose[:, 2] + np.pi / 2)])
    nees = pose_nees(pose + error, np.tile(covariance, (n, 1, 1)), truth, quarter)
    assert nees == pytest.approx(1.0, abs=4.0 * (2.0 / (3 * n)) ** 0.5)


def test_one_landmark_is_not_enough() -> None:
    with pytest.raises(NothingInCommon, match="1 landmark"):
        point_error(np.zeros((1, 2)), np.eye(2)[None], np.zeros((1, 2)))


# -- trajectories --------------------------------------------------------------------------------


def test_between_two_poses_a_trajectory_is_known_unless_they_lie_far_apart() -> None:
    track = Trajectory(np.array([0.0, 1.0, 4.0]), np.array([[0.0, 0.0, 3.0], [2.0, 4.0, -3.0], [8.0, 4.0, -3.0]]))
    found, known = track.at(np.array([-0.1, 0.0, 0.25, 1.0, 2.0, 4.0, 4.1]), 2.0)
    assert known.tolist() == [False, True, True, True, False, False, False]
    np.testing.assert_allclose(found.poses[2, :2], [0.5, 1.0])
    assert found.poses[2, 2] == pytest.approx(wrapped(np.array([3.0 + 0.25 * (2 * np.pi - 6.0)]))[0])
    assert not Trajectory(np.zeros(1), np.zeros((1, 3))).at(np.zeros(2), 1.0)[1].any()


def test_tum_files_come_back(tmp_path: Path) -> None:
    track = wander(9)
    back = read_tum(as_tum(track, tmp_path / "a.tum"))
    np.testing.assert_array_equal(back.t, track.t)
    np.testing.assert_allclose(back.poses, track.poses, atol=1e-15)


def test_of_a_tilted_pose_the_yaw_counts(tmp_path: Path) -> None:
    path = tmp_path / "a.tum"
    # A yaw of 0.9 after a roll of 0.2, not of unit length, and out of order.
    yaw, roll = np.array([np.cos(0.45), 0, 0, np.sin(0.45)]), np.array([np.cos(0.1), np.sin(0.1), 0, 0])
    w, x, y, z = 2.0 * np.array([yaw[0] * roll[0], yaw[0] * roll[1], yaw[3] * roll[1], yaw[3] * roll[0]])
    path.write_text(f"# t x y z\n2 1 1 5 {x} {y} {z} {w}\n1 0 0 0 0 0 0 1\n\n")
    track = read_tum(path)
    assert track.t.tolist() == [1.0, 2.0]
    assert track.poses[1].tolist() == pytest.approx([1.0, 1.0, 0.9])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("1 2 3\n", r":1: expected t x y z qx qy qz qw, got '1 2 3'"),
        ("1 2 3 0 0 0 0 0\n", r":1: expected t x y z"),
        ("1 2 3 0 0 0 0 x\n", r":1: expected a finite number, got 'x'"),
        ("# nothing\n", "found none"),
    ],
)
def test_a_broken_tum_file_is_named(text: str, says: str, tmp_path: Path) -> None:
    path = tmp_path / "a.tum"
    path.write_text(text)
    with pytest.raises(DatasetError, match=says):
        read_tum(path)
