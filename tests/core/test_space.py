"""Laws of SO(3), of poses in space, and of what the plane and space have in common."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from submaps.geometry import so3
from submaps.geometry.space import PLANE, SOLID, Space

Floats = NDArray[np.float64]
SPACES = [PLANE, SOLID]
SIZES = [0.0, 1e-12, 1e-7, 1e-3, 0.29, 0.31, 1.0, 3.0, math.pi - 1e-9]


def named(space: Space) -> str:
    return space.name


def a_pose(space: Space, rng: np.random.Generator, turn: float = 1.0) -> tuple[float, ...]:
    return space.as_pose(np.concatenate([rng.normal(size=space.dim) * 5.0, rng.normal(size=space.rot) * turn]))


def S(v: Floats) -> Floats:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def moved(space: Space, pose: tuple[float, ...], e: Floats) -> tuple[float, ...]:
    """The pose with error e: p + e_p, exp(e_theta) R."""
    turned = space.compose((*(0.0,) * space.dim, *e[space.dim :]), (*(0.0,) * space.dim, *pose[space.dim :]))
    return (*(np.array(pose[: space.dim]) + e[: space.dim]).tolist(), *turned[space.dim :])


def error(space: Space, pose: tuple[float, ...], base: tuple[float, ...]) -> Floats:
    """e with pose = moved(base, e)."""
    zero = (0.0,) * space.dim
    back = space.inverse((*zero, *base[space.dim :]))
    turned = space.compose((*zero, *pose[space.dim :]), back)
    return np.concatenate([np.array(pose[: space.dim]) - base[: space.dim], turned[space.dim :]])


@pytest.mark.parametrize("size", SIZES)
def test_rotation_vectors_agree_with_an_independent_library(size: float) -> None:
    rng = np.random.default_rng(3)
    for axis in rng.normal(size=(20, 3)):
        r = size * axis / np.linalg.norm(axis)
        theirs = Rotation.from_rotvec(r)
        out = np.empty((3, 3))
        so3.matrix(r[0], r[1], r[2], out)
        assert np.allclose(out, theirs.as_matrix(), atol=2e-15, rtol=0.0)
        assert np.allclose(so3.rotation_vector(so3.quaternion(*r)), r, atol=4e-15)
        q = np.array(so3.quaternion_of(out))
        assert np.allclose(q * np.sign(q[3]), theirs.as_quat(canonical=True), atol=2e-15)


@pytest.mark.parametrize("size", [1e-7, 0.05, 0.29, 0.31, 1.0, 3.0])
def test_the_left_jacobian_is_the_slope_of_the_exponential(size: float) -> None:
    rng = np.random.default_rng(4)
    r = rng.normal(size=3)
    r *= size / np.linalg.norm(r)
    V, W = np.empty((3, 3)), np.empty((3, 3))
    so3.left_jacobian(r[0], r[1], r[2], V)
    so3.left_jacobian_inverse(r[0], r[1], r[2], W)
    assert np.allclose(V @ W, np.eye(3), atol=2e-14)
    step = 1e-6
    for k in range(3):
        e = step * np.eye(3)[k]
        after, before = Rotation.from_rotvec(r + e), Rotation.from_rotvec(r - e)
        slope = (after * before.inv()).as_rotvec() / (2.0 * step)
        assert np.allclose(V[:, k], slope, atol=1e-9)


def test_series_do_not_jump_where_they_take_over() -> None:
    for f in (so3.series, so3.inverse_series):
        below, above = f(0.09 - 1e-15), f(0.09 + 1e-15)
        assert np.allclose(below, above, rtol=2e-13)
    for a in (0.2, 0.5, 2.5):
        h = 1e-5
        slope = (so3.inverse_series((a + h) ** 2)[0] - so3.inverse_series((a - h) ** 2)[0]) / (2 * h)
        assert so3.inverse_series(a * a)[1] == pytest.approx(slope / a, rel=1e-7)


@pytest.mark.parametrize("space", SPACES, ids=named)
def test_poses_form_a_group(space: Space) -> None:
    rng = np.random.default_rng(5)
    for _ in range(100):
        a, b, c = (a_pose(space, rng) for _ in range(3))
        left, right = space.compose(space.compose(a, b), c), space.compose(a, space.compose(b, c))
        assert np.allclose(error(space, left, right), 0.0, atol=1e-13)
        assert np.allclose(error(space, space.compose(a, space.inverse(a)), space.origin), 0.0, atol=1e-13)
        assert np.allclose(error(space, space.between(a, b), space.compose(space.inverse(a), b)), 0.0, atol=1e-13)
        assert np.allclose(error(space, space.exp(space.log(a)), a), 0.0, atol=1e-13)
        point = rng.normal(size=space.dim)
        inner = space.transform(a, space.transform(b, point))
        assert np.allclose(space.transform(space.compose(a, b), point), inner, atol=1e-13)


@pytest.mark.parametrize("space", SPACES, ids=named)
def test_a_point_turns_as_it_says(space: Space) -> None:
    rng = np.random.default_rng(6)
    point, e = rng.normal(size=space.dim), 1e-6 * rng.normal(size=space.rot)
    turned = space.rotation_of(e) @ point - space.rotation_of(-e) @ point
    assert np.allclose(turned, 2.0 * space.turn(point) @ e, atol=1e-16)
    V = space.left_jacobian(0.7 * np.ones(space.rot))
    steps = [space.rotation_of(0.7 * np.ones(space.rot) * (k + 0.5) / 2000) for k in range(2000)]
    assert np.allclose(V, np.mean(steps, axis=0), atol=1e-7)  # V is the mean rotation on the way


@pytest.mark.parametrize("space", SPACES, ids=named)
def test_covariances_of_poses_follow_the_slopes(space: Space) -> None:
    rng = np.random.default_rng(7)
    a, b = a_pose(space, rng), a_pose(space, rng)
    n, h = space.pose, 1e-6
    by_a, by_b, by_inverse = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    moves: list[tuple[Floats, Callable[[Floats], tuple[float, ...]]]] = [
        (by_a, lambda e: space.compose(moved(space, a, e), b)),
        (by_b, lambda e: space.compose(a, moved(space, b, e))),
        (by_inverse, lambda e: space.inverse(moved(space, a, e))),
    ]
    for out, of in moves:
        middle = of(np.zeros(n))
        for k, e in enumerate(h * np.eye(n)):
            out[:, k] = (error(space, of(e), middle) - error(space, of(-e), middle)) / (2 * h)
    cov_a, cov_b = (root @ root.T for root in rng.normal(size=(2, n, n)))
    expected = by_a @ cov_a @ by_a.T + by_b @ cov_b @ by_b.T
    assert np.allclose(space.compose_covariance(a, cov_a, b, cov_b), expected, rtol=1e-7, atol=1e-6)
    assert np.allclose(space.inverse_covariance(a, cov_a), by_inverse @ cov_a @ by_inverse.T, rtol=1e-7, atol=1e-6)


def test_the_cross_product_is_the_turn_in_space() -> None:
    assert np.array_equal(SOLID.turn(np.array([1.0, 2.0, 3.0])), -S(np.array([1.0, 2.0, 3.0])))
