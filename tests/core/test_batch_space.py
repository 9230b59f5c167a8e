"""The full-batch optimum in space: with odometry, without, and with one camera."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from submaps.batch import optimum
from submaps.batch_problem import Problem, State
from submaps.config import Camera, Depth, MotionConfig, ObservationConfig
from submaps.consistency import chi_square_bound
from submaps.flight import Flight, Volume, fly
from submaps.geometry.space import SOLID
from submaps.measurements import Batch
from tests.core.support import jacobian

Floats = NDArray[np.float64]

AHEAD = (0.05, -0.1, 0.2, -0.5, 0.5, -0.5, 0.5)  # the camera's z axis along the body's x, its x to the right
STEREO = ObservationConfig("stereo", (1.0, 1.5, 1.0, 2.0), AHEAD, Camera(480.0, 470.0, 320.0, 240.0, 0.24))
PINHOLE = ObservationConfig("pinhole", (1.0, 1.5), AHEAD, Camera(480.0, 470.0, 320.0, 240.0), Depth(5.0, 1.0))
CARTESIAN = ObservationConfig("cartesian3d", (0.05, 0.04, 0.06), AHEAD)
SENSORS = [STEREO, PINHOLE, CARTESIAN]
ODOMETRY, NONE = MotionConfig("odometry3d", (0.1,) * 6), MotionConfig("none", ())


def name(observation: ObservationConfig) -> str:
    return observation.model


def swing(share: float, steps: int = 40, marks: int = 12) -> Volume:
    """To and fro before a wall of points, always looking at it; noise of the odometry ``share`` of its size."""
    rng = np.random.default_rng(8)
    k = np.arange(steps)
    way = np.stack([0.1 * np.cos(0.3 * k), 0.3 * np.cos(0.2 * k), 0.1 * np.sin(0.25 * k)], axis=1)
    turn = 0.05 * np.stack([np.cos(0.4 * k), np.sin(0.3 * k), np.cos(0.2 * k + 1.0)], axis=1)
    points = rng.uniform((4.0, -2.0, -1.5), (7.0, 2.0, 1.5), (marks, 3))
    return Volume(points, np.hstack([way, turn]), 20.0, share, (0, 0.5 * math.pi))


def flown(observation: ObservationConfig, noise: float, share: float = 0.1, seed: int = 1) -> Flight:
    sharp = replace(observation, sigma=tuple(max(noise, 1e-9) * s for s in observation.sigma))
    flight = fly(swing(noise * share), np.random.default_rng(seed), sharp)
    own = None if noise == 0.0 else flight.batch.control_covariance
    return replace(flight, batch=replace(flight.batch, control_covariance=own, observation_covariance=None))


def without_motion(batch: Batch) -> Batch:
    return replace(
        batch, control_step=np.empty(0, dtype=np.int64), control=np.empty((0, 0)), control_covariance=None
    )  # fmt: skip


def wall(ids: tuple[str, ...]) -> Floats:
    return swing(0.0).landmarks[[int(i) for i in ids]]


@pytest.mark.parametrize("observation", SENSORS, ids=name)
def test_without_noise_the_optimum_is_the_truth(observation: ObservationConfig) -> None:
    flight = flown(observation, noise=0.0)
    far = replace(observation, depth=Depth(5.0, 1e6)) if observation is PINHOLE else observation  # says nothing
    found = optimum(flight.batch, ODOMETRY, far, chunk=7)
    assert found.chi2 < 1e-10
    assert found.freedom == flight.batch.z.size - 3 * 12 + (12 if observation is PINHOLE else 0)
    np.testing.assert_allclose(found.landmarks, wall(found.ids), atol=1e-5)
    np.testing.assert_allclose(found.poses, flight.poses, atol=1e-5)


@pytest.mark.parametrize("observation", [STEREO, CARTESIAN], ids=name)
def test_without_motion_the_frame_is_that_of_the_first_step_that_sees(observation: ObservationConfig) -> None:
    flight = flown(observation, noise=0.0)
    found = optimum(without_motion(flight.batch), NONE, observation, chunk=7)
    assert np.isnan(found.poses[0]).all()  # nothing is seen before the first step
    first = SOLID.as_pose(flight.poses[1])
    local = SOLID.transform(SOLID.inverse(first), wall(found.ids))
    np.testing.assert_allclose(found.landmarks, local, atol=1e-7)
    expected = [SOLID.between(first, SOLID.as_pose(pose)) for pose in flight.poses[1:]]
    np.testing.assert_allclose(found.poses[1:], expected, atol=1e-7)


def test_without_motion_a_step_that_sees_too_little_has_no_pose() -> None:
    batch = without_motion(flown(STEREO, noise=1.0).batch)
    seen = batch.observation_step != 20
    seen[np.flatnonzero(~seen)[:2]] = True  # two readings are left at step 20
    names = tuple(mark for mark, own in zip(batch.landmark, seen, strict=True) if own)
    thin = replace(batch, observation_step=batch.observation_step[seen], landmark=names, z=batch.z[:, seen].copy())
    found = optimum(thin, NONE, STEREO)
    assert np.flatnonzero(np.isnan(found.poses[:, 0])).tolist() == [0, 20]
    assert found.freedom == 4 * (len(names) - 2) - 6 * 38 - 3 * 12


def moved(pose: Floats, e: Floats) -> Floats:
    """The pose with error e: p + e_p, exp(e_theta) R."""
    turned = Rotation.from_rotvec(e[3:]) * Rotation.from_rotvec(pose[3:])
    return np.concatenate([pose[:3] + e[:3], turned.as_rotvec()])


@pytest.mark.parametrize("observation", SENSORS, ids=name)
def test_derivatives_are_those_of_the_residuals(observation: ObservationConfig) -> None:
    flight = flown(observation, noise=1.0)
    problem = Problem.of(flight.batch, ODOMETRY, observation)
    random = np.random.default_rng(2)
    poses = np.array([moved(pose, 0.1 * random.normal(size=6)) for pose in flight.poses])
    state = State(poses, wall(problem.ids) + 0.1 * random.normal(size=(12, 3)))
    stop = 5
    at = problem.linearise(state, stop)
    free = 6 * (stop - 1)

    def residual(errors: Floats) -> Floats:
        there = State(state.poses.copy(), state.landmarks + errors[free:].reshape(-1, 3))
        for k, e in enumerate(errors[:free].reshape(-1, 6), start=1):
            there.poses[k] = moved(state.poses[k], e)
        return problem.linearise(there, stop).residual

    numeric = jacobian(residual, np.zeros(free + 36), h=1e-3)
    analytic = at.jacobian.toarray()
    assert np.abs(analytic - numeric).max() < 1e-6 * np.abs(numeric).max()


@pytest.mark.parametrize("motion", [ODOMETRY, NONE], ids=["odometry", "none"])
def test_no_small_move_lowers_the_cost_which_is_what_the_noise_implies(motion: MotionConfig) -> None:
    costs, freedom = 0.0, 0
    for seed in range(5):
        batch = flown(STEREO, noise=1.0, seed=seed).batch
        batch = batch if motion is ODOMETRY else without_motion(batch)
        found = optimum(batch, motion, STEREO)
        costs, freedom = costs + found.chi2, freedom + found.freedom
        problem = Problem.of(batch, motion, STEREO)
        known = ~np.isnan(found.poses[:, 0])
        best, random = State(found.poses[known], found.landmarks), np.random.default_rng(3)
        assert problem.linearise(best, problem.poses).cost == pytest.approx(found.chi2, rel=1e-9)
        for _ in range(5):
            step = 1e-4 * random.normal(size=6 * (problem.poses - 1) + 36)
            away = problem.moved_back(best, problem.poses, step)
            assert problem.linearise(away, problem.poses).cost > found.chi2
    assert chi_square_bound(0.005, freedom) < costs < chi_square_bound(0.995, freedom)


def test_the_optimum_is_nearer_to_the_truth_than_its_start() -> None:
    flight = flown(STEREO, noise=1.0)
    problem = Problem.of(flight.batch, ODOMETRY, STEREO)
    start = State(np.zeros((problem.poses, 6)), np.zeros((12, 3)))
    problem.extend(start, 0, problem.poses)
    found = optimum(flight.batch, ODOMETRY, STEREO)
    truth = wall(found.ids)
    assert np.linalg.norm(found.landmarks - truth) < 0.5 * np.linalg.norm(start.landmarks - truth)
    assert np.linalg.norm(found.poses - flight.poses) < 0.5 * np.linalg.norm(start.poses - flight.poses)


def test_a_library_for_factor_graphs_finds_the_same_bundle() -> None:
    gtsam = pytest.importorskip("gtsam")
    even = replace(STEREO, sigma=(1.0, 2.0, 1.0, 2.0), camera=Camera(480.0, 470.0, 320.0, 240.0, 0.24))
    batch = without_motion(flown(even, noise=1.0).batch)
    ours = optimum(batch, NONE, even)

    calibration = gtsam.Cal3_S2Stereo(480.0, 470.0, 0.0, 320.0, 240.0, 0.24)
    mount = gtsam.Pose3(gtsam.Rot3.Quaternion(0.5, -0.5, 0.5, -0.5), np.array(AHEAD[:3]))
    # It knows one row for both images: the mean of two, whose variance is half that of either.
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([1.0, 1.0, math.sqrt(2.0)]))
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(gtsam.NonlinearEqualityPose3(1, gtsam.Pose3()))
    for k in range(1, batch.steps):
        pose = gtsam.Pose3(gtsam.Rot3.Expmap(ours.poses[k, 3:]), ours.poses[k, :3])
        values.insert(k, pose.retract(np.full(6, 0.01)) if k > 1 else pose)
    for i, mark in enumerate(ours.ids):
        values.insert(gtsam.symbol("l", int(mark)), ours.landmarks[i] + 0.05)
    for k, mark, z in zip(batch.observation_step.tolist(), batch.landmark, batch.z.T, strict=True):
        point = gtsam.StereoPoint2(z[0], z[2], 0.5 * (z[1] + z[3]))
        graph.add(gtsam.GenericStereoFactor3D(point, noise, k, gtsam.symbol("l", int(mark)), calibration, mount))
    theirs = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    points = [theirs.atPoint3(gtsam.symbol("l", int(mark))) for mark in ours.ids]
    np.testing.assert_allclose(ours.landmarks, points, atol=1e-4)
    for k in range(1, batch.steps):
        np.testing.assert_allclose(ours.poses[k, :3], theirs.atPose3(k).translation(), atol=1e-4)
