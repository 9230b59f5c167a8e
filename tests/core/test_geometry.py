"""Laws of the trigonometry and of SE(2)."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from submaps.geometry import se2, trig
from tests.core.support import R, V, after, jacobian, random_covariance, wrapped

settings.register_profile("laws", derandomize=True, deadline=None, max_examples=300)
settings.load_profile("laws")

angles = st.floats(-1e5, 1e5, allow_nan=False)
lengths = st.floats(-1e3, 1e3, allow_nan=False)
poses = st.tuples(lengths, lengths, st.floats(-math.pi, math.pi, exclude_max=True))
near = st.tuples(*[st.floats(-1e-6, 1e-6)] * 3)
ORIGIN = (0.0, 0.0, 0.0)


def close(a: se2.Pose, b: se2.Pose, scale: float = 1e3) -> bool:
    """Whether two poses are equal up to rounding at coordinates of size ``scale``."""
    turn = abs(wrapped(a[2] - b[2]))
    return math.hypot(a[0] - b[0], a[1] - b[1]) < 2e-14 * scale and turn < 4e-15


@given(angles)
def test_sine_and_cosine_are_good_to_an_ulp(x: float) -> None:
    s, c = trig.sincos(x)
    # Near a multiple of pi/2 the argument's own reduction bounds the absolute error.
    assert abs(s - math.sin(x)) <= 2.0 * math.ulp(math.sin(x)) + 1e-19 * abs(x)
    assert abs(c - math.cos(x)) <= 2.0 * math.ulp(math.cos(x)) + 1e-19 * abs(x)


def test_sine_and_cosine_over_a_dense_grid_and_near_the_quadrants() -> None:
    quadrants = np.pi / 2 * np.arange(-40, 41)
    grid = np.concatenate([np.linspace(-30.0, 30.0, 20001), *(quadrants + d for d in (0.0, 1e-9, -1e-5, 0.1))])
    for x in grid:
        s, c = trig.sincos(float(x))
        assert abs(s - math.sin(x)) <= 1.0 * math.ulp(math.sin(x)) + 1e-20
        assert abs(c - math.cos(x)) <= 1.0 * math.ulp(math.cos(x)) + 1e-20


@pytest.mark.parametrize("x", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_has_no_sine(x: float) -> None:
    assert not any(math.isfinite(v) for v in trig.sincos(x))


@given(
    st.floats(-1e300, 1e300).filter(lambda v: v == 0.0 or abs(v) > 1e-300),
    st.floats(-1e300, 1e300).filter(lambda v: v == 0.0 or abs(v) > 1e-300),
)
def test_arc_tangent_is_good_to_two_ulps(y: float, x: float) -> None:
    expected = math.atan2(y + 0.0, x + 0.0)  # + 0.0: the sign of a zero means nothing here
    assert abs(trig.arctan2(y, x) - expected) <= 2.0 * math.ulp(expected)


def test_arc_tangent_over_the_whole_circle() -> None:
    for angle in np.linspace(-math.pi, math.pi, 20001):
        for radius in (1e-9, 1.0, 3e7):
            y, x = radius * math.sin(angle), radius * math.cos(angle)
            expected = math.atan2(y, x)
            assert abs(trig.arctan2(y, x) - expected) <= 2.0 * math.ulp(expected)
    assert trig.arctan2(0.0, -1.0) == math.pi
    assert trig.arctan2(0.0, 0.0) == 0.0
    assert trig.arctan2(-2.0, 0.0) == -0.5 * math.pi


@given(angles)
def test_a_wrapped_angle_is_the_same_angle_in_one_turn(angle: float) -> None:
    around = trig.wrap(angle)
    slack = 4.0 * math.ulp(angle)
    assert -math.pi - slack <= around <= math.pi + slack
    turns = (angle - around) / (2.0 * math.pi)
    assert abs(turns - round(turns)) <= 1e-15 * (1.0 + abs(angle))


def test_wrap_is_half_open_and_leaves_what_is_inside() -> None:
    assert trig.wrap(math.pi) == -math.pi
    assert trig.wrap(-math.pi) == -math.pi
    inside = math.nextafter(math.pi, 0.0)
    assert trig.wrap(inside) == inside


@given(st.floats(-30.0, 30.0))
def test_the_series_of_a_rotation(phi: float) -> None:
    a, b = trig.rotation_series(phi)
    expected = V(phi)
    assert abs(a - expected[0, 0]) <= 4e-16
    # 1 - cos(phi) keeps an absolute error of half an ulp of one
    assert abs(b - expected[1, 0]) <= 4e-16 + (1.2e-16 / abs(phi) if abs(phi) > 0.1 else 0.0)


@pytest.mark.parametrize("phi", [0.0, 1e-100, -1e-12, 1e-4, 0.0999999])
def test_the_series_keeps_every_digit_of_a_small_rotation(phi: float) -> None:
    a, b = trig.rotation_series(phi)
    assert a == pytest.approx(V(phi)[0, 0], rel=4e-16)
    assert b == pytest.approx(V(phi)[1, 0], rel=6e-16, abs=0.0)


def test_the_series_meets_the_closed_form() -> None:
    below, above = trig.rotation_series(0.1), trig.rotation_series(math.nextafter(0.1, 1.0))
    assert below == pytest.approx(above, abs=3e-15)


@given(poses, poses, poses)
def test_poses_form_a_group(a: se2.Pose, b: se2.Pose, c: se2.Pose) -> None:
    assert close(se2.compose(se2.compose(a, b), c), se2.compose(a, se2.compose(b, c)), 1e4)
    assert close(se2.compose(a, ORIGIN), a)
    assert close(se2.compose(ORIGIN, a), a)
    assert close(se2.compose(a, se2.inverse(a)), ORIGIN, 1e4)
    assert close(se2.compose(se2.inverse(a), a), ORIGIN, 1e4)
    assert close(se2.between(a, b), se2.compose(se2.inverse(a), b), 1e4)


@given(poses, poses)
def test_composition_is_rotation_then_translation(a: se2.Pose, b: se2.Pose) -> None:
    x, y, theta = after(np.array(a), np.array(b))
    assert close(se2.compose(a, b), (float(x), float(y), float(theta)))
    point = se2.transform(a, b[0], b[1])
    assert point == pytest.approx((x, y), abs=1e-11)


@given(st.tuples(lengths, lengths, st.floats(-3.0, 3.0)) | near)
def test_log_undoes_exp(xi: se2.Pose) -> None:
    size = 1e-18 + math.hypot(xi[0], xi[1])
    assert np.allclose(se2.log(se2.exp(xi)), xi, rtol=0.0, atol=4e-15 * max(size, abs(xi[2])))


@given(st.tuples(lengths, lengths, st.floats(-3.14, 3.14)) | near)
def test_exp_undoes_log(pose: se2.Pose) -> None:
    size = 1e-18 + math.hypot(pose[0], pose[1])
    assert np.allclose(se2.exp(se2.log(pose)), pose, rtol=0.0, atol=4e-15 * max(size, abs(pose[2])))


@given(st.tuples(*[st.floats(-2.0, 2.0)] * 3))
def test_exp_is_the_matrix_exponential(xi: se2.Pose) -> None:
    generator = np.array([[0.0, -xi[2], xi[0]], [xi[2], 0.0, xi[1]], [0.0, 0.0, 0.0]]) / 1024
    term, whole = np.eye(3), np.eye(3)
    for k in range(1, 6):
        term = term @ generator / k
        whole = whole + term
    whole = np.linalg.matrix_power(whole, 1024)
    x, y, theta = se2.exp(xi)
    assert np.allclose(whole[:2, :2], R(theta), atol=1e-11)
    assert np.allclose(whole[:2, 2], (x, y), atol=1e-11)


@given(poses, st.tuples(*[st.floats(-1.0, 1.0)] * 3))
def test_the_adjoint_carries_a_tangent_across(a: se2.Pose, xi: se2.Pose) -> None:
    moved = se2.adjoint(a) @ xi
    left = se2.compose(se2.exp((float(moved[0]), float(moved[1]), float(moved[2]))), a)
    assert close(se2.compose(a, se2.exp(xi)), left, 1e4)


@pytest.mark.parametrize("seed", range(5))
def test_covariances_of_composed_and_inverse_poses(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=3) * (10, 10, 1), rng.normal(size=3) * (10, 10, 1)
    cov_a, cov_b = random_covariance(rng, 3), random_covariance(rng, 3)
    J = jacobian(lambda v: after(v[:3], v[3:]), np.concatenate([a, b]))
    whole = J[:, :3] @ cov_a @ J[:, :3].T + J[:, 3:] @ cov_b @ J[:, 3:].T
    pose_a, pose_b = (float(a[0]), float(a[1]), float(a[2])), (float(b[0]), float(b[1]), float(b[2]))
    assert np.allclose(se2.compose_covariance(pose_a, cov_a, pose_b, cov_b), whole, rtol=1e-8, atol=1e-9)
    J = jacobian(lambda v: np.array([*(-R(v[2]).T @ v[:2]), -v[2]]), a)
    assert np.allclose(se2.inverse_covariance(pose_a, cov_a), J @ cov_a @ J.T, rtol=1e-8, atol=1e-9)
    twice = se2.inverse_covariance(se2.inverse(pose_a), se2.inverse_covariance(pose_a, cov_a))
    assert np.allclose(twice, cov_a, rtol=1e-10, atol=1e-10)
