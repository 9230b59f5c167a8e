"""Errors of trajectories and of landmarks in space: laws, and agreement with evo on the same files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from evo.core import metrics, sync
from evo.core.trajectory import PoseTrajectory3D
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from service.datasets.tum import read_tum
from service.wire.poses import tum_rest
from submaps.alignment import align
from submaps.evaluation import NothingInCommon, absolute_error, associate, point_error, pose_nees, relative_error
from submaps.geometry.space import SOLID, Pose
from submaps.trajectory import Trajectory

Floats = NDArray[np.float64]


def flight(seed: int, count: int = 300) -> Trajectory:
    """A flight in bends."""
    random = np.random.default_rng(seed)
    poses = [SOLID.origin]
    for turn in 0.1 * random.normal(size=(count - 1, 3)):
        poses.append(SOLID.compose(poses[-1], (0.1, 0.0, 0.0, *turn.tolist())))
    return Trajectory(0.1 * np.arange(count, dtype=np.float64), np.array(poses))


def perturbed(track: Trajectory, seed: int) -> Trajectory:
    """Another trajectory near one: poses off, some missing, all of it in another frame."""
    random = np.random.default_rng(seed)
    kept = np.sort(random.permutation(len(track))[: int(0.7 * len(track))])
    frame, poses = (3.0, -2.0, 1.0, 0.4, -0.9, 1.1), []
    for row, off in zip(track.poses[kept], random.normal(size=(len(kept), 6)) * 0.03, strict=True):
        poses.append(SOLID.compose(frame, SOLID.compose(SOLID.as_pose(row), SOLID.as_pose(off))))
    return Trajectory(track.t[kept] + random.uniform(-0.003, 0.003, len(kept)), np.array(poses))


def as_tum(track: Trajectory, path: Path) -> Path:
    rows = zip(track.t.tolist(), track.poses, strict=True)
    path.write_text("".join(f"{t!r} {tum_rest(SOLID.as_pose(row))}\n" for t, row in rows))
    return path


def evo_trajectory(path: Path) -> PoseTrajectory3D:
    rows = np.loadtxt(path)
    return PoseTrajectory3D(rows[:, 1:4], rows[:, [7, 4, 5, 6]], rows[:, 0])


@pytest.mark.parametrize("seed", range(3))
def test_numbers_are_those_of_evo(seed: int, tmp_path: Path) -> None:
    truth = as_tum(flight(seed), tmp_path / "truth.tum")
    estimate = as_tum(perturbed(flight(seed), seed + 10), tmp_path / "estimate.tum")
    own, true = associate(read_tum(estimate, "se3"), read_tum(truth, "se3"), 0.01)
    reference, found = sync.associate_trajectories(evo_trajectory(truth), evo_trajectory(estimate), max_diff=0.01)
    relative, turn = relative_error(own, true, 0.5)
    for ours, relation in ((relative, "translation_part"), (turn, "rotation_angle_rad")):
        error = metrics.RPE(metrics.PoseRelation[relation], 0.5, metrics.Unit.meters, all_pairs=False)
        error.process_data((reference, found))
        assert (ours.rmse, ours.max) == pytest.approx(
            (error.get_statistic(metrics.StatisticsType.rmse), error.error.max())
        )
        assert ours.count == len(error.error)
    for aligned in (False, True):
        if aligned:
            found.align(reference)
        error = metrics.APE(metrics.PoseRelation.translation_part)
        error.process_data((reference, found))
        ours = absolute_error(own, true, aligned=aligned)
        assert ours.rmse == pytest.approx(error.get_statistic(metrics.StatisticsType.rmse), abs=1e-9)


def test_tum_files_come_back(tmp_path: Path) -> None:
    track = flight(5)
    back = read_tum(as_tum(track, tmp_path / "a.tum"), "se3")
    np.testing.assert_array_equal(back.t, track.t)
    np.testing.assert_allclose(back.poses, track.poses, atol=1e-14)


turns = st.floats(-2.0, 2.0)


@given(turns, turns, turns, st.integers(3, 30), st.integers(0, 2**31))
def test_align_finds_a_motion_back(x: float, y: float, z: float, n: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    a, motion = 10.0 * random.normal(size=(n, 3)), (*random.normal(size=3).tolist(), x, y, z)
    b = SOLID.transform(motion, a)
    found = align(a, b)
    assert found.space is SOLID
    assert found.rmse < 1e-9
    np.testing.assert_allclose(SOLID.rotation(found.pose), SOLID.rotation(motion), atol=1e-7)
    np.testing.assert_allclose(found.apply(a), b, atol=1e-8)


def test_points_in_a_plane_are_turned_and_not_mirrored() -> None:
    """Noise that a reflection would fit better: det R stays 1."""
    random = np.random.default_rng(2)
    a = np.column_stack([random.normal(size=(8, 2)), 0.01 * random.normal(size=8)])
    b = a * (1.0, 1.0, -1.0)
    assert np.linalg.det(SOLID.rotation(align(a, b).pose)) == pytest.approx(1.0)


def test_no_turn_is_better_than_the_one_that_align_finds() -> None:
    random = np.random.default_rng(4)
    a = random.normal(size=(20, 3))
    b = a + 0.3 * random.normal(size=(20, 3))
    found = align(a, b)
    for off in 0.2 * random.normal(size=(50, 3)):
        R = SOLID.rotation(found.pose) @ SOLID.rotation_of(off)
        turned = (a - a.mean(axis=0)) @ R.T + b.mean(axis=0)
        assert np.sqrt(np.mean(np.sum((turned - b) ** 2, axis=1))) >= found.rmse - 1e-12


def test_between_two_poses_a_rotation_goes_at_a_constant_rate_the_short_way() -> None:
    a, b = (0.0, 0.0, 0.0, 0.0, 0.0, 3.0), (1.0, 2.0, 3.0, 0.0, 0.0, -3.0)
    track = Trajectory(np.array([0.0, 4.0]), np.array([a, b]))
    found, known = track.at(np.array([1.0, 4.0, 4.1]), 5.0)
    assert known.tolist() == [True, True, False]
    np.testing.assert_allclose(found.poses[0, :3], [0.25, 0.5, 0.75])
    np.testing.assert_allclose(found.poses[0, 3:], [0.0, 0.0, 3.0 + 0.25 * (2.0 * np.pi - 6.0)])
    np.testing.assert_allclose(found.poses[1], b)
    assert Trajectory(np.zeros(1), np.zeros((1, 6))).at(np.zeros(2), 1.0)[0].poses.shape == (2, 6)


# -- NEES ----------------------------------------------------------------------------------------


def test_nees_of_points_is_one_where_the_covariances_are_true() -> None:
    """The alignment takes 6 of 3n degrees of freedom; the covariances stand along the axes of the map."""
    random = np.random.default_rng(7)
    n, runs = 12, 300
    sigma, frame = np.array([0.01, 0.01, 0.01]), (4.0, 1.0, -2.0, 0.7, -0.3, 1.9)
    truth = 5.0 * random.normal(size=(n, 3))
    there = SOLID.transform(SOLID.inverse(frame), truth)
    covariances = np.tile(np.diag(np.square(sigma)), (n, 1, 1))
    found = [
        point_error(there + sigma * random.normal(size=(n, 3)), covariances, truth).nees for _ in range(runs)
    ]  # fmt: skip
    assert np.mean(found) == pytest.approx(1.0, abs=4.0 * (2.0 / ((3 * n - 6) * runs)) ** 0.5)


def test_nees_of_poses_has_its_rotation_about_the_axes_of_the_map() -> None:
    """Errors of very different size about and along each axis, in the map's frame; the truth is in another."""
    random = np.random.default_rng(8)
    n, sigma = 2000, np.array([1.0, 0.01, 0.1, 0.1, 0.001, 0.01])
    frame: Pose = (2.0, 3.0, -1.0, 0.5, 1.2, -0.8)
    estimate, truth = [], []
    for e in sigma * random.normal(size=(n, 6)):
        pose = (*(10.0 * random.normal(size=3)).tolist(), *Rotation.random(random_state=random).as_rotvec().tolist())
        turned = SOLID.compose((0.0, 0.0, 0.0, *e[3:].tolist()), (0.0, 0.0, 0.0, *pose[3:]))
        estimate.append(pose)
        truth.append(SOLID.compose(frame, (*np.add(pose[:3], e[:3]).tolist(), *turned[3:])))
    laid = align(np.array(estimate)[:5, :3], SOLID.transform(frame, np.array(estimate)[:5, :3]))
    covariances = np.tile(np.diag(np.square(sigma)), (n, 1, 1))
    nees = pose_nees(np.array(estimate), covariances, np.array(truth), laid)
    assert nees == pytest.approx(1.0, abs=4.0 * (2.0 / (6 * n)) ** 0.5)


def test_two_landmarks_are_not_enough() -> None:
    with pytest.raises(NothingInCommon, match="2 landmark"):
        point_error(np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1)), np.zeros((2, 3)))
