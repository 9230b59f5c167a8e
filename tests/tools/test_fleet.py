"""The batch optimum of several robots, and the chains of composed increments that it stands on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from service.datasets import read_source
from submaps.alignment import align
from submaps.batch import optimum
from submaps.chains import chain, place_at, place_of_steps
from submaps.config import MotionConfig
from submaps.errors import NumericalError
from submaps.filtering.predicting import accumulate
from submaps.fleet_batch import FleetOptimum, Guess, fleet_optimum
from submaps.fleet_problem import cauchy, problem_of
from submaps.geometry.se2 import between, compose
from submaps.measurements import Batch, encounter
from submaps.motion.increments import increments
from submaps.trajectory import Trajectory
from tests.tools.fleet import DT, LANDMARKS, MOTION, OBSERVATION, STEPS, Fleet, drive, pose_at

Floats = NDArray[np.float64]


def errors(found: FleetOptimum, fleet: Fleet) -> tuple[float, float]:
    """Largest errors of landmarks and of poses (m and rad alike), in the frame of the first robot's first pose."""
    marks = np.array([LANDMARKS[name] for name in found.ids]).reshape(-1, 2)
    worst = 0.0
    for name, track in found.trajectories.items():
        true = fleet.poses[name][np.searchsorted(fleet.robots[name].t, track.t)]
        difference = track.poses - true
        difference[:, 2] = np.remainder(difference[:, 2] + np.pi, 2 * np.pi) - np.pi
        worst = max(worst, float(np.abs(difference).max()))
    return float(np.abs(found.landmarks - marks).max(initial=0.0)), worst


# -- chains --------------------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(0.0, STEPS - 1.0), min_size=1, max_size=12))
def test_a_chain_composes_to_the_same_whole_wherever_it_is_cut(places: list[float]) -> None:
    batch = drive(1.0).robots["ann"]
    cut = chain(batch, MOTION, np.array([*places, STEPS - 1.0]))
    whole = chain(batch, MOTION, np.array([STEPS - 1.0]))
    pose = (0.0, 0.0, 0.0)
    for x, y, theta in cut.increment.tolist():
        pose = compose(pose, (x, y, theta))
    dx, dy, turn = between(pose, (float(whole.increment[0, 0]), float(whole.increment[0, 1]),
                                  float(whole.increment[0, 2])))  # fmt: skip
    assert max(abs(dx), abs(dy), abs(turn)) < 1e-12
    assert np.linalg.eigvalsh(cut.covariance).min() > -1e-18


def test_between_steps_a_chain_composes_as_the_filter_does() -> None:
    batch = drive(1.0).robots["bob"]
    steps, noises = increments(MOTION, batch, None)
    found = chain(batch, MOTION, np.array([7.0, 31.0, 32.0]))
    assert found.place.tolist() == [0.0, 7.0, 31.0, 32.0]
    for i, (begin, end) in enumerate([(0, 7), (7, 31), (31, 32)]):
        pose, covariance = np.zeros(3), np.zeros((3, 3))
        for k in range(begin, end):
            accumulate(pose, covariance, steps[k], noises[k])
        np.testing.assert_allclose(found.increment[i], pose, atol=1e-14)
        np.testing.assert_allclose(found.covariance[i], covariance, rtol=1e-12, atol=1e-18)


def test_a_place_between_two_steps_is_where_the_arc_was_then() -> None:
    batch = drive(0.0).robots["ann"]
    t = np.array([3.21, 17.9, 30.05])
    places = place_at(batch, t)
    found = chain(batch, MOTION, places)
    pose = (0.0, 0.0, 0.0)
    for k, (x, y, theta) in enumerate(found.increment.tolist()):
        pose = compose(pose, (x, y, theta))
        np.testing.assert_allclose(pose, pose_at("ann", t[k], 0.0), atol=1e-12)


def test_places_outside_the_run_are_unknown_and_standing_still_is_one_place() -> None:
    batch = drive(0.0).robots["ann"]
    assert np.isnan(place_at(batch, np.array([-0.1, batch.t[-1] + 0.1]))).all()
    still = Batch(batch.t, batch.control_step[10:], batch.control[:, 10:], None, *_nothing())
    assert place_of_steps(still)[:11].tolist() == [0] * 11
    assert place_at(still, np.array([0.2, 3.0, batch.t[10] + 0.25 * DT])).tolist() == pytest.approx([0.0, 0.0, 0.25])
    alone = Batch(batch.t[:1], np.zeros(0, np.int64), np.zeros((2, 0)), None, *_nothing())
    assert place_at(alone, np.array([0.0, 1.0])).tolist() == pytest.approx([0.0, np.nan], nan_ok=True)


def _nothing() -> tuple[NDArray[np.int64], tuple[str, ...], Floats, None]:
    return np.zeros(0, np.int64), (), np.zeros((2, 0)), None


# -- the optimum ---------------------------------------------------------------------------------


@pytest.mark.parametrize(("landmarks", "meet"), [(True, True), (True, False), (False, True)])
@pytest.mark.parametrize("gate", [None, 0.999])
def test_without_noise_the_optimum_is_the_truth(landmarks: bool, meet: bool, gate: float | None) -> None:
    fleet = drive(0.0, landmarks=landmarks, meet=meet)
    found = fleet_optimum(fleet.robots, MOTION, OBSERVATION, gate=gate)
    assert found.chi2 < 1e-9
    assert max(errors(found, fleet)) < 1e-6
    assert all(used.all() for used in found.used.values())


def test_a_robot_alone_that_sees_at_every_step_has_the_optimum_of_its_poses() -> None:
    batch = drive(1.0, meet=False, every=1).robots["ann"]
    alone, fleet = optimum(batch, MOTION, OBSERVATION), fleet_optimum({"ann": batch}, MOTION, OBSERVATION)
    assert fleet.chi2 == pytest.approx(alone.chi2, rel=1e-9)
    np.testing.assert_allclose(fleet.landmarks, alone.landmarks, atol=1e-5)
    np.testing.assert_allclose(fleet.trajectories["ann"].poses, alone.poses, atol=1e-5)


def test_two_robots_know_more_than_one() -> None:
    """Over many runs the errors of the second robot's landmarks fall when the first one's readings count too."""
    alone: list[float] = []
    both: list[float] = []
    for seed in range(10):
        fleet = drive(1.0, seed=seed)
        ann = fleet_optimum({"ann": fleet.robots["ann"]}, MOTION, OBSERVATION)
        together = fleet_optimum(fleet.robots, MOTION, OBSERVATION)
        for found, into in ((ann, alone), (together, both)):
            into.append(align(found.landmarks, np.array([LANDMARKS[name] for name in found.ids])).rmse)
    assert np.mean(both) < 0.85 * np.mean(alone)


def test_the_cost_has_the_size_of_its_degrees_of_freedom() -> None:
    """χ² of readings and moves less the unknowns: its mean over runs lies within 4 standard deviations."""
    costs, freedom = [], 0
    for seed in range(10):
        fleet = drive(1.0, seed=seed)
        problem = problem_of(fleet.robots, MOTION, OBSERVATION)
        freedom = 2 * len(problem.pose) + 3 * len(problem.before) - 3 * (problem.poses - 1) - 2 * len(problem.ids)
        costs.append(fleet_optimum(fleet.robots, MOTION, OBSERVATION).chi2)
    assert abs(np.mean(costs) - freedom) < 4.0 * np.sqrt(2.0 * freedom / len(costs))


def test_gross_errors_are_left_out_and_the_rest_is_kept() -> None:
    fleet = drive(1.0, outliers=0.05)
    gated = fleet_optimum(fleet.robots, MOTION, OBSERVATION, gate=0.999)
    every = fleet_optimum(fleet.robots, MOTION, OBSERVATION)
    clean = drive(1.0)
    for name, used in gated.used.items():
        off = np.abs(fleet.robots[name].z - clean.robots[name].z) > np.array([[0.5], [0.2]])
        gross = off.any(axis=0)
        assert not used[gross].any()
        assert used[~gross].mean() > 0.97
    assert errors(gated, fleet)[0] < 0.5 * errors(every, fleet)[0]


def test_a_guess_leads_to_the_same_optimum() -> None:
    fleet = drive(1.0)
    found = fleet_optimum(fleet.robots, MOTION, OBSERVATION)
    tracks = {name: Trajectory(fleet.robots[name].t, fleet.poses[name] + 0.05) for name in fleet.robots}
    marks = {name: np.array(point) for name, point in LANDMARKS.items() if name != "oak"}
    again = fleet_optimum(fleet.robots, MOTION, OBSERVATION, guess=Guess(marks, tracks))
    assert again.chi2 == pytest.approx(found.chi2, rel=1e-8)
    # The guess puts the first pose elsewhere, and there it stays: the same map in another frame.
    assert align(again.landmarks, found.landmarks).rmse < 1e-4


def test_readings_show_derivatives_of_their_residuals() -> None:
    problem = problem_of(drive(1.0).robots, MOTION, OBSERVATION)
    random = np.random.default_rng(3)
    x = 5.0 * random.normal(size=3 * problem.poses + 2 * len(problem.ids))
    rows = np.arange(len(problem.pose))
    by = problem.residual(x, rows)[1]
    for column in range(5):
        at = 3 * problem.pose + column if column < 3 else problem.target + column - 3
        h, numeric = 1e-6, np.zeros((len(rows), 2))
        for i in random.choice(rows, 40, replace=False).tolist():
            ends = []
            for sign in (h, -h):
                there = x.copy()
                there[at[i]] += sign
                ends.append(problem.residual(there, np.array([i]))[0][0])
            numeric[i] = (ends[0] - ends[1]) / (2 * h)
            np.testing.assert_allclose(by[i, :, column], numeric[i], atol=2e-3 * max(1.0, np.abs(numeric[i]).max()))


def test_the_kernel_is_the_square_for_small_errors_and_its_weight_the_slope() -> None:
    s = np.geomspace(1e-6, 1e4, 50)
    cost, weight = cauchy(s)
    assert cost[0] == pytest.approx(s[0], rel=1e-5)
    slope = (cauchy(s * (1 + 1e-6))[0] - cauchy(s * (1 - 1e-6))[0]) / (2e-6 * s)
    np.testing.assert_allclose(weight, slope, rtol=1e-4)
    assert np.all(np.diff(weight) < 0.0)


def test_a_robot_that_nothing_ties_to_the_others_is_named() -> None:
    fleet = drive(1.0, meet=False)
    bob = fleet.robots["bob"]
    apart = Batch(bob.t, bob.control_step, bob.control, None, bob.observation_step,
                  tuple(f"{name}'" for name in bob.landmark), bob.z, None)  # fmt: skip
    with pytest.raises(NumericalError, match="nothing ties robot 'bob'"):
        fleet_optimum({"ann": fleet.robots["ann"], "bob": apart}, MOTION, OBSERVATION)


def test_sightings_of_strangers_and_outside_a_run_do_not_count() -> None:
    ann = drive(1.0, meet=False).robots["ann"]
    names = list(ann.landmark)
    names[5], names[11] = encounter("zoe", 1.0), encounter("bob", 1e6)
    odd = Batch(ann.t, ann.control_step, ann.control, None, ann.observation_step, tuple(names), ann.z, None)
    found = fleet_optimum({"ann": odd, "bob": drive(1.0, meet=False).robots["bob"]}, MOTION, OBSERVATION)
    assert np.flatnonzero(~found.used["ann"]).tolist() == [5, 11]


def test_progress_rises_to_the_whole() -> None:
    calls: list[tuple[int, int]] = []
    fleet = drive(1.0)
    fleet_optimum(fleet.robots, MOTION, OBSERVATION, progress=lambda done, total: calls.append((done, total)))
    done = [call[0] for call in calls]
    assert done == sorted(done)
    assert calls[-1][0] == calls[-1][1]


def test_an_arc_without_slip_is_solved_all_the_same() -> None:
    fleet = drive(0.0)
    found = fleet_optimum(fleet.robots, MotionConfig("velocity", (0.02, 0.02), noise="density"), OBSERVATION)
    assert max(errors(found, fleet)) < 1e-5


def test_five_robots_of_a_real_run_find_the_landmarks(data_dir: Path) -> None:
    run = read_source(str(data_dir / "mrclam_7"))
    assert run.truth is not None
    found = fleet_optimum(run.robots, run.motion, run.observation, gate=run.config.gate)
    truth = np.array([run.truth.landmarks[name] for name in found.ids])
    assert align(found.landmarks, truth).rmse < 0.07
    for used in found.used.values():
        assert used.mean() > 0.96
