"""Laws of the motion models: increments, covariances, and how increments compose."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from submaps.config import MotionConfig
from submaps.filtering.closing import flush
from submaps.motion.increments import dead_reckon, increments
from submaps.submap import ActiveSubmap
from tests.core.support import Step, after, batch, jacobian, random_covariance

Floats = NDArray[np.float64]


def velocity(v: float, omega: float, dt: float, sigma: tuple[float, ...] = (0.3, 0.2)) -> tuple[Floats, Floats]:
    """Increment and covariance of one velocity reading."""
    steps, noises = increments(MotionConfig("velocity", sigma), batch([Step((v, omega), t=dt)]), 0.0)
    return steps[0], noises[0]


def slide(v: float, slip: float, omega: float, dt: float) -> Floats:
    """The pose after constant body velocities, by Gauss-Legendre quadrature of the path."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    heading = omega * dt * 0.5 * (nodes + 1.0)
    w = 0.5 * dt * weights
    x = float(np.sum(w * (v * np.cos(heading) - slip * np.sin(heading))))
    y = float(np.sum(w * (v * np.sin(heading) + slip * np.cos(heading))))
    return np.array([x, y, omega * dt])


def test_odometry_is_its_own_increment() -> None:
    steps = [Step(None), Step((1.0, -0.2, 0.1)), Step((0.5, 0.0, -3.0))]
    moved, noise = increments(MotionConfig("odometry", (0.1, 0.2, 0.3)), batch(steps), None)
    assert np.array_equal(moved, [[1.0, -0.2, 0.1], [0.5, 0.0, -3.0]])
    assert np.allclose(noise, np.diag([0.01, 0.04, 0.09]), rtol=1e-15)


@pytest.mark.parametrize("omega", [2.0, -1.3, 0.3, 1e-3, -1e-7, 1e-12, 0.0])
def test_velocity_follows_the_arc(omega: float) -> None:
    moved, _ = velocity(1.7, omega, 0.8)
    assert np.allclose(moved, slide(1.7, 0.0, omega, 0.8), rtol=0.0, atol=2e-15)


@pytest.mark.parametrize("phi", [0.1, 0.3])
def test_velocity_is_smooth_where_the_series_take_over(phi: float) -> None:
    below, above = velocity(1.0, math.nextafter(phi, 0.0), 1.0), velocity(1.0, math.nextafter(phi, 1.0), 1.0)
    assert np.allclose(below[0], above[0], atol=1e-14)
    assert np.allclose(below[1], above[1], atol=1e-14)


def test_a_straight_line_is_the_limit_of_arcs() -> None:
    straight = velocity(2.0, 0.0, 0.5)
    assert np.array_equal(straight[0], [1.0, 0.0, 0.0])
    for omega in (1e-3, 1e-6, 1e-9):
        bent = velocity(2.0, omega, 0.5)
        assert np.allclose(bent[0], straight[0], rtol=0.0, atol=omega)
        assert np.allclose(bent[1], straight[1], rtol=0.0, atol=omega)


@pytest.mark.parametrize("omega", [2.0, -0.5, 0.25, 1e-4, 0.0])
@pytest.mark.parametrize("slip", [None, 0.4])
def test_the_covariance_of_an_arc(omega: float, slip: float | None) -> None:
    v, dt = 1.3, 0.7
    sigma = (0.3, 0.2) if slip is None else (0.3, 0.2, slip)
    J = jacobian(lambda c: slide(c[0], c[1], c[2], dt), np.array([v, 0.0, omega]))
    expected = J @ np.diag(np.square([0.3, slip or 0.0, 0.2])) @ J.T
    _, noise = velocity(v, omega, dt, sigma)
    assert np.allclose(noise, expected, rtol=1e-9, atol=1e-12)


def test_a_control_may_bring_its_own_covariance() -> None:
    rng = np.random.default_rng(1)
    own = np.stack([random_covariance(rng, 2, 0.1), random_covariance(rng, 2, 0.1)])
    for count in (1, 2):
        sent = replace(batch([Step((1.0, 0.4), t=0.5 + k) for k in range(count)]), control_covariance=own[:count])
        _, noises = increments(MotionConfig("velocity", (9.0, 9.0)), sent, 0.0)
        for k, dt in zip(range(count), (0.5, 1.0), strict=False):
            J = jacobian(lambda c, dt=dt: slide(c[0], 0.0, c[1], dt), np.array([1.0, 0.4]))  # type: ignore[misc]
            assert np.allclose(noises[k], J @ own[k] @ J.T, rtol=1e-9, atol=1e-12)


def test_a_control_lasts_from_the_step_before_it() -> None:
    sent = batch([Step(None, t=1.0), Step((1.0, 0.0), t=1.5), Step(None, t=4.0), Step((1.0, 0.0), t=4.25)])
    moved, _ = increments(MotionConfig("velocity", (0.1, 0.1)), sent, None)
    assert moved[:, 0] == pytest.approx([0.5, 0.25], rel=1e-15)
    first = batch([Step((1.0, 0.0), t=3.0)])
    assert increments(MotionConfig("velocity", (0.1, 0.1)), first, None)[0][0, 0] == 0.0
    assert increments(MotionConfig("velocity", (0.1, 0.1)), first, 1.0)[0][0, 0] == 2.0


def test_dead_reckoning_composes_poses_and_their_errors() -> None:
    rng = np.random.default_rng(2)
    steps = rng.normal(size=(30, 3)) * (1.0, 0.3, 0.8)
    noises = np.stack([random_covariance(rng, 3, 0.1) for _ in steps])
    pose, covariance = np.zeros(3), np.zeros((3, 3))
    expected, P = np.zeros(3), np.zeros((3, 3))
    for step, noise in zip(steps, noises, strict=True):
        J = jacobian(lambda v: after(v[:3], v[3:]), np.concatenate([expected, step]))
        P = J[:, :3] @ P @ J[:, :3].T + J[:, 3:] @ noise @ J[:, 3:].T
        expected = after(expected, step)
    at, track = np.arange(30) * 2 + 1, np.empty((61, 3))
    dead_reckon(pose, covariance, steps, noises, at, track)
    assert np.array_equal(track[0], np.zeros(3))
    assert np.array_equal(track[2:60:2], track[1:59:2])  # a step without control stays where it is
    assert np.array_equal(track[60], pose)
    assert np.allclose(pose[:2], expected[:2], atol=1e-12)
    assert math.remainder(pose[2] - expected[2], 2.0 * math.pi) == pytest.approx(0.0, abs=1e-13)
    assert np.allclose(covariance, P, rtol=1e-8, atol=1e-10)
    assert np.array_equal(covariance, covariance.T)


def generic(rng: np.random.Generator, landmarks: int) -> ActiveSubmap:
    """A sub-map in a generic state, its covariance full."""
    n = 3 + 2 * landmarks
    s = ActiveSubmap(0, 0, 0.0, landmarks)
    s.counts[0] = n
    s.x[:n] = rng.normal(size=n) * 5.0
    s.P[:n, :n] = random_covariance(rng, n, 0.1)
    return s


@pytest.mark.parametrize("invariant", [True, False])
def test_accumulated_increments_predict_like_each_in_turn(invariant: bool) -> None:
    """The filter with F = I is exact in this; the textbook one too, as its F composes."""
    steps = np.random.default_rng(3).normal(size=(20, 3)) * (1.0, 0.3, 0.5)
    noises = np.stack([random_covariance(np.random.default_rng(k), 3, 0.05) for k in range(20)])
    once, each = generic(np.random.default_rng(4), 3), generic(np.random.default_rng(4), 3)
    dead_reckon(once.motion[:3], once.motion[3:12].reshape(3, 3), steps, noises, np.arange(20), np.empty((20, 3)))
    flush(once.x, once.P, once.counts, once.motion, int(invariant), once.scratch)
    for step, noise in zip(steps, noises, strict=True):
        each.motion[:3], each.motion[3:12] = step, noise.ravel()
        flush(each.x, each.P, each.counts, each.motion, int(invariant), each.scratch)
    n = once.dimension
    assert np.allclose(once.x[:n], each.x[:n], rtol=0.0, atol=1e-12)
    scale = np.sqrt(np.outer(np.diag(each.P[:n, :n]), np.diag(each.P[:n, :n])))
    assert np.max(np.abs(once.P[:n, :n] - each.P[:n, :n]) / scale) < 1e-12
