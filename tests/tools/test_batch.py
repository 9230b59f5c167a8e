"""The full-batch optimum and the alignment that accuracies are measured with."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from service.datasets import read_source
from submaps.alignment import align
from submaps.batch import optimum
from submaps.batch_problem import Problem, State
from submaps.config import MotionConfig, ObservationConfig
from submaps.errors import NumericalError
from submaps.measurements import Batch

Floats = NDArray[np.float64]
ODOMETRY = MotionConfig("odometry", (0.1, 0.1, 0.02))
MOUNT = (0.4, -0.2, 0.3)
CARTESIAN = ObservationConfig("cartesian", (0.1, 0.2), MOUNT)
RANGE_BEARING = ObservationConfig("range_bearing", (0.1, 0.05), MOUNT)


TURN = 0.17
STRAIGHT, ARC = complex(1.0), (np.exp(1j * TURN) - 1.0) / (1j * TURN)  # a metre of way, as x + iy


def circle(observation: ObservationConfig, noise: float, way: complex = STRAIGHT) -> tuple[Batch, Floats, Floats]:
    """A drive round a circle past six landmarks: batch, true poses (step 0 at the origin), landmarks."""
    random = np.random.default_rng(3)
    n = 40
    poses = np.zeros((n, 3))
    for k in range(1, n):
        x, y, theta = poses[k - 1]
        moved = way * np.exp(1j * theta)
        poses[k] = x + moved.real, y + moved.imag, theta + TURN
    landmarks = np.array([[3.0, 2.0], [8.0, 3.0], [-4.0, 6.0], [0.0, 9.0], [5.0, 14.0], [-6.0, 12.0]])
    step = np.repeat(np.arange(n), 6)
    seen = np.tile(np.arange(6), n)
    z = readings(observation, poses[step], landmarks[seen])
    control: Floats = np.tile([[way.real], [way.imag], [TURN]], n - 1)
    control += noise * np.array(ODOMETRY.sigma)[:, None] * random.normal(size=control.shape)
    z += noise * np.array(observation.sigma)[:, None] * random.normal(size=z.shape)
    names = tuple(f"tree {j}" for j in seen)
    batch = Batch(np.arange(n, dtype=np.float64), np.arange(1, n), control, None, step, names, z, None)
    return batch, poses, landmarks


def readings(observation: ObservationConfig, pose: Floats, landmark: Floats) -> Floats:
    d = (landmark - pose[:, :2]) @ np.eye(2)
    body = (d[:, 0] + 1j * d[:, 1]) * np.exp(-1j * pose[:, 2])
    sensor = (body - complex(*observation.mount[:2])) * np.exp(-1j * observation.mount[2])
    if observation.model == "cartesian":
        return np.array([sensor.real, sensor.imag])
    return np.array([np.abs(sensor), np.angle(sensor)])


@pytest.mark.parametrize("observation", [CARTESIAN, RANGE_BEARING])
def test_without_noise_the_optimum_is_the_truth(observation: ObservationConfig) -> None:
    batch, poses, landmarks = circle(observation, noise=0.0)
    found = optimum(batch, ODOMETRY, observation, chunk=7)
    assert found.chi2 < 1e-12
    assert found.ids == tuple(f"tree {j}" for j in range(6))
    np.testing.assert_allclose(found.landmarks, landmarks, atol=1e-7)
    np.testing.assert_allclose(found.poses, poses, atol=1e-7)


@pytest.mark.parametrize("observation", [CARTESIAN, RANGE_BEARING])
def test_no_small_move_lowers_the_cost(observation: ObservationConfig) -> None:
    batch, _, _ = circle(observation, noise=1.0)
    found = optimum(batch, ODOMETRY, observation)
    problem = Problem.of(batch, ODOMETRY, observation)
    random = np.random.default_rng(1)

    def cost(poses: Floats, landmarks: Floats) -> float:
        state = State(poses, landmarks)
        moved, seen = (
            problem.motion_rows(state, problem.poses)[0],
            problem.observation_rows(state, problem.poses)[0],
        )
        return float(np.sum(moved**2) + np.sum(seen**2))

    assert cost(found.poses, found.landmarks) == pytest.approx(found.chi2, rel=1e-12)
    for _ in range(20):
        poses = found.poses + 1e-4 * random.normal(size=found.poses.shape)
        poses[0] = 0.0
        assert cost(poses, found.landmarks + 1e-4 * random.normal(size=(6, 2))) > found.chi2


@pytest.mark.parametrize("observation", [CARTESIAN, RANGE_BEARING])
def test_derivatives_are_those_of_the_residuals(observation: ObservationConfig) -> None:
    batch, _, _ = circle(observation, noise=1.0)
    problem = Problem.of(batch, ODOMETRY, observation)
    random = np.random.default_rng(2)
    state = State(random.normal(size=(problem.poses, 3)), 5.0 * random.normal(size=(6, 2)))
    h = 1e-6
    by_motion = problem.motion_rows(state, problem.poses)[1]
    by_seen = problem.observation_rows(state, problem.poses)[1]
    for axis in range(3):
        for parity in (0, 1):  # poses of one parity at a time: each residual then sees one of them
            ends = []
            for sign in (h, -h):
                there = State(state.poses.copy(), state.landmarks)
                there.poses[parity::2, axis] += sign
                ends.append(problem.motion_rows(there, problem.poses)[0])
            numeric = (ends[0] - ends[1]) / (2 * h)
            before, after = numeric[parity::2], numeric[1 - parity :: 2]
            np.testing.assert_allclose(by_motion[parity::2, :, axis], before, atol=1e-6)
            np.testing.assert_allclose(by_motion[1 - parity :: 2, :, 3 + axis], after, atol=1e-6)
        pair = [State(state.poses + sign * np.eye(3)[axis], state.landmarks) for sign in (h, -h)]
        seen = [problem.observation_rows(there, problem.poses)[0] for there in pair]
        np.testing.assert_allclose(by_seen[:, :, axis], (seen[0] - seen[1]) / (2 * h), atol=1e-5)
    for axis in range(2):
        pair = [State(state.poses, state.landmarks + sign * np.eye(2)[axis]) for sign in (h, -h)]
        seen = [problem.observation_rows(there, problem.poses)[0] for there in pair]
        np.testing.assert_allclose(by_seen[:, :, 3 + axis], (seen[0] - seen[1]) / (2 * h), atol=1e-5)


def test_covariances_of_the_batch_take_the_place_of_sigma() -> None:
    batch, _, _ = circle(CARTESIAN, noise=1.0)
    spelled = Batch(
        batch.t,
        batch.control_step,
        batch.control,
        np.tile(np.diag(np.square(ODOMETRY.sigma)), (39, 1, 1)),
        batch.observation_step,
        batch.landmark,
        batch.z,
        np.tile(np.diag(np.square(CARTESIAN.sigma)), (240, 1, 1)),
    )
    other = ObservationConfig("cartesian", (9.0, 9.0), MOUNT)
    ours = optimum(batch, ODOMETRY, CARTESIAN)
    theirs = optimum(spelled, MotionConfig("odometry", (9.0, 9.0, 9.0)), other)
    np.testing.assert_allclose(ours.landmarks, theirs.landmarks, atol=1e-9)


def test_steps_without_control_share_the_pose_before_them() -> None:
    batch, poses, landmarks = circle(CARTESIAN, noise=0.0)
    step, t = batch.observation_step, np.repeat(batch.t, 2)
    doubled = Batch(t, 2 * batch.control_step, batch.control, None, 2 * step + 1, batch.landmark, batch.z, None)
    found = optimum(doubled, ODOMETRY, CARTESIAN)
    np.testing.assert_allclose(found.poses, np.repeat(poses, 2, axis=0), atol=1e-7)
    np.testing.assert_allclose(found.landmarks, landmarks, atol=1e-7)


def test_an_arc_without_slip_has_a_singular_increment_and_is_solved_all_the_same() -> None:
    batch, _, landmarks = circle(CARTESIAN, noise=0.0, way=ARC)
    control = np.array([[1.0] * 39, [TURN] * 39])
    arc = Batch(batch.t, batch.control_step, control, None, batch.observation_step, batch.landmark, batch.z, None)
    found = optimum(arc, MotionConfig("velocity", (0.5, 0.2)), CARTESIAN)
    np.testing.assert_allclose(found.landmarks, landmarks, atol=1e-6)


def test_progress_rises_to_the_whole() -> None:
    batch, _, _ = circle(CARTESIAN, noise=0.5)
    calls: list[tuple[int, int]] = []
    optimum(batch, ODOMETRY, CARTESIAN, chunk=10, progress=lambda done, total: calls.append((done, total)))
    assert calls == [(11, 40), (21, 40), (31, 40), (40, 40)]


def test_readings_that_are_not_finite_are_refused() -> None:
    batch, _, _ = circle(CARTESIAN, noise=0.5)
    batch.z[0, 5] = np.nan
    with pytest.raises(NumericalError):
        optimum(batch, ODOMETRY, CARTESIAN)


@pytest.mark.parametrize(("file", "chi2"), [("victoriaPark.txt", 6183.93), ("cityTrees10000.txt", 8668.93)])
def test_the_known_optimum_of_a_file_is_reached(data_dir: Path, file: str, chi2: float) -> None:
    run = read_source(str(data_dir / "isam" / file))
    found = optimum(run.columns, run.motion, run.observation, chunk=1000)
    assert found.chi2 == pytest.approx(chi2, abs=0.005)


def test_victoria_park_with_sigma_rounded_as_in_the_wire_contract(data_dir: Path) -> None:
    run = read_source(str(data_dir / "isam" / "victoriaPark.txt"))
    rounded = ObservationConfig("cartesian", (0.6325, 0.6325))
    assert optimum(run.columns, run.motion, rounded, chunk=1000).chi2 == pytest.approx(6183.69, abs=0.005)


angles = st.floats(-3.1, 3.1)
metres = st.floats(-1e3, 1e3)


@given(angles, metres, metres, st.integers(2, 30), st.integers(0, 2**31))
def test_align_finds_a_motion_back(theta: float, x: float, y: float, n: int, seed: int) -> None:
    a = 10.0 * np.random.default_rng(seed).normal(size=(n, 2))
    c, s = np.cos(theta), np.sin(theta)
    b = a @ np.array([[c, s], [-s, c]]) + (x, y)
    found = align(a, b)
    assert found.rmse < 1e-9
    assert found.theta == pytest.approx(theta, abs=1e-8) or n == 2
    np.testing.assert_allclose(found.apply(a), b, atol=1e-8)


def test_no_turn_is_better_than_the_one_that_align_finds() -> None:
    random = np.random.default_rng(4)
    a = random.normal(size=(20, 2))
    b = a + 0.3 * random.normal(size=(20, 2))
    found = align(a, b)
    for theta in found.theta + np.linspace(-0.5, 0.5, 11):
        c, s = np.cos(theta), np.sin(theta)
        turned = (a - a.mean(axis=0)) @ np.array([[c, s], [-s, c]]) + b.mean(axis=0)
        assert np.sqrt(np.mean(np.sum((turned - b) ** 2, axis=1))) >= found.rmse - 1e-12
    assert found.rmse_before == pytest.approx(np.sqrt(np.mean(np.sum((a - b) ** 2, axis=1))))


def test_align_wants_the_same_points_twice() -> None:
    with pytest.raises(ValueError, match="expected two arrays of shape"):
        align(np.zeros((3, 2)), np.zeros((4, 2)))
