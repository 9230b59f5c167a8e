"""What non-odometry SLAM starts from, and its world: bundle adjustment from nothing but views, poses, errors."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from submaps.consistency import average_bounds, nees
from submaps.nonodometry.belief import Belief
from submaps.nonodometry.bundle import Bundle, adjust
from submaps.nonodometry.errors import euclidean, mahalanobis, shape
from submaps.nonodometry.initial import from_views
from submaps.nonodometry.likelihood import linearise
from submaps.nonodometry.moments import extended
from submaps.nonodometry.poses import Poses, exp, log
from submaps.nonodometry.sensor import Camera
from submaps.nonodometry.spiral import Spiral, observe, spiral
from submaps.nonodometry.update import update

Floats = NDArray[np.float64]

CAMERA = Camera(noise=1.0, focal=(500.0, 500.0), centre=(320.0, 240.0))


def baseline(world: Spiral, views: int) -> float:
    return float(np.linalg.norm(world.poses.position[views - 1] - world.poses.position[0]))


def started(seed: int, views: int, noise: float = 1.0) -> Bundle:
    world, camera = spiral(), Camera(noise, CAMERA.focal, CAMERA.centre)
    z = observe(world, camera, np.random.default_rng(seed))[:views]
    return from_views(camera, z, world.poses.take(0), baseline(world, views))


# -- poses ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [0.0, 1e-9, 9e-5, 1.1e-4, 0.3, 2.0, 3.1])
def test_rotations_of_vectors_and_back(angle: float) -> None:
    axes = np.random.default_rng(1).normal(size=(4, 5, 3))
    theta = angle * axes / np.linalg.norm(axes, axis=-1, keepdims=True)
    expected = Rotation.from_rotvec(theta.reshape(-1, 3)).as_matrix().reshape(4, 5, 3, 3)
    assert np.allclose(exp(theta), expected, rtol=0, atol=1e-15)
    assert np.allclose(log(exp(theta)), theta, rtol=0, atol=1e-13)


def test_a_retraction_comes_back_and_a_point_in_the_body_goes_back_to_the_map() -> None:
    rng = np.random.default_rng(2)
    pose = Poses(exp(rng.normal(size=3)), rng.normal(size=3))
    xi = rng.normal(size=(7, 6))
    moved = pose.retract(xi)
    assert np.allclose(moved.minus(pose), xi, atol=1e-13)
    points = rng.normal(size=(7, 4, 3))
    back = np.einsum("kij,kjn->kni", moved.rotation, moved.to_body(points)) + moved.position[:, np.newaxis]
    assert np.allclose(back, points, atol=1e-13)


# -- the world -----------------------------------------------------------------------------------


def test_the_world_is_the_papers() -> None:
    world = spiral()
    assert world.points.shape == (32, 3)
    for half in (world.points[:16], world.points[16:]):  # each on a plane
        assert np.linalg.svd(half - half.mean(axis=0))[1][2] < 1e-12
    assert np.linalg.svd(world.points - world.points.mean(axis=0))[1][2] > 1.0
    forward, position = world.poses.rotation[:, :, 2], world.poses.position
    assert np.allclose(forward[:, 2], 0.0)  # at a right angle to the vertical axis
    meets = position + forward * np.linalg.norm(position[:, :2], axis=1, keepdims=True)
    assert np.allclose(meets[:, :2], 0.0, atol=1e-12)
    assert np.allclose(np.linalg.det(world.poses.rotation), 1.0)
    assert CAMERA.sees(world.poses.to_body(world.points)).all()
    apart = np.linalg.norm(np.diff(position, axis=0), axis=1)
    assert np.allclose(apart, apart[0])


# -- maps from views -----------------------------------------------------------------------------


@pytest.mark.parametrize("views", [2, 4, 16])
def test_without_noise_the_views_alone_give_the_points(views: int) -> None:
    found = started(1, views, noise=1e-9)
    assert found.found
    assert np.abs(found.belief.points - spiral().points).max() < 1e-8
    assert np.abs(found.poses.position - spiral().poses.position[:views]).max() < 1e-8


@pytest.mark.parametrize("views", [4, 16])
def test_the_gauge_is_held_and_the_optimum_has_no_gradient(views: int) -> None:
    world, found = spiral(), started(2, views)
    assert np.array_equal(found.poses.position[0], world.poses.position[0])
    assert np.array_equal(found.poses.rotation[0], world.poses.rotation[0])
    assert np.linalg.norm(found.poses.position[-1] - found.poses.position[0]) == pytest.approx(baseline(world, views))
    z = observe(world, CAMERA, np.random.default_rng(2))[:views]
    view = linearise(CAMERA, found.poses, np.broadcast_to(found.belief.points, (views, 32, 3)), z)
    by_points = np.einsum("jdki,jdk->ki", view.by_point.reshape(views, 2, 32, 3), view.residual.reshape(views, 2, 32))
    size = np.sqrt(np.diag(found.belief.covariance)).reshape(32, 3)
    assert np.abs(by_points * size).max() < 1e-3  # in standard deviations
    by_poses = np.einsum("jap,ja->jp", view.by_pose, view.residual)[1:-1]
    assert np.abs(by_poses).max() < 1e-3 * np.abs(view.by_pose).max()


def test_the_covariance_is_the_inverse_of_the_whole_information_under_that_gauge() -> None:
    """The dense normal equations of points and poses, with the gauge's seven directions left out."""
    views, found = 3, started(3, 3)
    z = observe(spiral(), CAMERA, np.random.default_rng(3))[:views]
    view = linearise(CAMERA, found.poses, np.broadcast_to(found.belief.points, (views, 32, 3)), z)
    J = np.zeros((views, 64, 96 + 6 * views))
    for j in range(views):
        J[j, :, 96 + 6 * j : 102 + 6 * j] = view.by_pose[j]
        for row in range(64):
            J[j, row, 3 * (row % 32) : 3 * (row % 32) + 3] = view.by_point[j, row]
    along = found.poses.position[-1] - found.poses.position[0]
    held = np.zeros((7, 96 + 6 * views))
    held[:6, 96:102] = np.eye(6)
    held[6, 96 + 6 * (views - 1) : 99 + 6 * (views - 1)] = along
    free = np.linalg.svd(held)[2][7:].T
    dense = J.reshape(-1, J.shape[2]) @ free
    covariance = free @ np.linalg.inv(dense.T @ dense) @ free.T
    assert np.allclose(found.belief.covariance, covariance[:96, :96], rtol=0, atol=1e-7 * covariance.max())


def test_starts_from_views_are_consistent_and_leave_a_residual_of_its_degrees_of_freedom() -> None:
    runs, views, world = 8, 16, spiral()
    starts = [started(seed, views) for seed in range(runs)]
    assert all(start.found for start in starts)
    low, high = average_bounds(0.999, 96, runs)
    assert low < np.mean([mahalanobis(start.belief, world.points) for start in starts]) < high
    freedom = 64 * views - 96 - 6 * views + 7
    low, high = average_bounds(0.999, freedom, runs)
    assert low < np.mean([start.cost / freedom for start in starts]) < high


def test_the_ekf_through_the_other_views_ends_at_the_optimum_of_all_of_them() -> None:
    """Started from some views and filtered through the rest, against one adjustment with the same gauge."""
    world, first, last = spiral(), 16, 60
    z = observe(world, CAMERA, np.random.default_rng(7))
    start = from_views(CAMERA, z[:first], world.poses.take(0), baseline(world, first))
    belief, pose = start.belief, start.poses.take(first - 1)
    for view in z[first:last]:
        after = update(extended, CAMERA, belief, view, pose)
        assert after.pose is not None
        belief, pose = after.belief, after.pose
    order = np.array([*range(first - 1), *range(first, last), first - 1])  # the gauge's second camera comes last
    whole = adjust(CAMERA, z[order], world.points, world.poses.take(order))
    assert whole.found
    apart = (belief.points - whole.belief.points).ravel()
    assert nees(apart, whole.belief.covariance) / 96 < 0.05
    sizes = np.diag(belief.covariance) / np.diag(whole.belief.covariance)
    assert np.all((sizes > 0.9) & (sizes < 1.1))


def test_views_from_one_place_give_nothing() -> None:
    world = spiral()
    z = observe(world, CAMERA, np.random.default_rng(4))[:1]
    found = from_views(CAMERA, np.repeat(z, 3, axis=0), world.poses.take(0), 1.0)
    assert not found.found


def test_an_adjustment_that_sees_a_point_behind_a_camera_is_not_found() -> None:
    world = spiral()
    z = observe(world, CAMERA, np.random.default_rng(5))[:4]
    away = Poses(world.poses.rotation[:4] @ np.diag([-1.0, 1.0, -1.0]), world.poses.position[:4])
    assert not adjust(CAMERA, z, world.points, away, rounds=3).found


# -- errors --------------------------------------------------------------------------------------


def test_a_similarity_is_no_error_of_shape() -> None:
    truth, rng = spiral().points, np.random.default_rng(6)
    moved = 1.3 * truth @ exp(rng.normal(size=3)).T + rng.normal(size=3)
    assert euclidean(moved, truth) > 1.0
    assert shape(moved, truth) < 1e-12
    mirrored = truth * (1.0, 1.0, -1.0) + 0.01 * rng.normal(size=truth.shape)
    mirrored[0] += (0.3, 0.2, 0.1)
    assert shape(mirrored, truth) <= euclidean(mirrored, truth)


def test_the_normalised_error_is_one_where_each_coordinate_is_off_by_its_sigma() -> None:
    truth = spiral().points
    assert mahalanobis(Belief(truth + 0.2, 0.04 * np.eye(96)), truth) == pytest.approx(1.0)
