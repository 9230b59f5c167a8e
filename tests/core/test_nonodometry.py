"""Non-odometry SLAM: one update by the EKF and the three UKFs, against closed forms and over many runs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from submaps.consistency import average_bounds, nees
from submaps.errors import MeasurementError
from submaps.filtering.unscented import Scaling
from submaps.nonodometry import sigma_poses
from submaps.nonodometry.belief import Belief, Status, Update, view_at
from submaps.nonodometry.errors import mahalanobis
from submaps.nonodometry.initial import noisy
from submaps.nonodometry.likelihood import linearise, maximum_likelihood
from submaps.nonodometry.moments import Filter, Moments, Unscented, extended
from submaps.nonodometry.poses import Poses, exp
from submaps.nonodometry.sensor import Camera
from submaps.nonodometry.spiral import observe, spiral
from submaps.nonodometry.update import update

Floats = NDArray[np.float64]

CAMERA = Camera(noise=0.7, focal=(520.0, 480.0), centre=(310.0, 250.0))
EXACT: dict[str, Filter] = {
    "EKF": extended,
    "linear": Unscented(sigma_poses.linear),
    "likelihood": Unscented(sigma_poses.maximum_likelihood),
}
FILTERS: dict[str, Filter] = {**EXACT, "constant": Unscented(sigma_poses.constant)}


@dataclass(frozen=True)
class Scene:
    """A belief about the paper's points, a view of them, and the pose it was taken from."""

    belief: Belief
    z: Floats
    truth: Poses
    camera: Camera
    points: Floats


def scene(seed: int, sigma: float = 0.01, noise: float = 0.7, view: int = 60) -> Scene:
    world, rng = spiral(), np.random.default_rng(seed)
    camera = Camera(noise, CAMERA.focal, CAMERA.centre)
    z = observe(world, camera, rng)
    return Scene(noisy(world.points, sigma, rng), z[view], world.poses.take(view), camera, world.points)


def near(pose: Poses) -> Poses:
    return pose.retract(np.array([0.1, -0.2, 0.1, 0.05, 0.1, -0.05]))


def updated(filter_: Filter, one: Scene) -> Update:
    found = update(filter_, one.camera, one.belief, one.z, near(one.truth))
    assert found.status is Status.done
    return found


# -- one view ------------------------------------------------------------------------------------


def test_both_jacobians_against_central_differences() -> None:
    one = scene(1)
    pose = near(one.truth).repeat(1)
    points, z = one.belief.points[np.newaxis], one.z[np.newaxis]
    view, step = linearise(CAMERA, pose, points, z), 1e-6
    for k in range(6):
        xi = np.zeros((1, 6))
        xi[0, k] = step
        ahead, behind = (linearise(CAMERA, pose.retract(s * xi), points, z).residual for s in (1.0, -1.0))
        assert np.allclose(view.by_pose[..., k], (behind - ahead) / (2 * step), rtol=1e-6, atol=1e-6)
    for k in range(3):
        shift = step * np.eye(3)[k]
        ahead, behind = (linearise(CAMERA, pose, points + s * shift, z).residual for s in (1.0, -1.0))
        assert np.allclose(view.by_point[..., k], (behind - ahead) / (2 * step), rtol=1e-6, atol=1e-6)


def test_the_likeliest_pose_is_the_true_one_without_noise_and_has_no_gradient_with_it() -> None:
    world = spiral()
    pose = world.poses.take(77)
    z = CAMERA.observe(pose.to_body(world.points)).T
    far = pose.retract(np.array([0.5, 0.4, -0.5, 0.3, -0.3, 0.4])).repeat(1)
    found = maximum_likelihood(CAMERA, world.points[np.newaxis], z, far)
    assert found.found[0]
    assert np.allclose(found.poses.minus(pose.repeat(1)), 0.0, atol=1e-9)
    one = scene(2)
    fit = maximum_likelihood(one.camera, one.belief.points[np.newaxis], one.z, far)
    assert fit.found[0]
    view = linearise(one.camera, fit.poses, one.belief.points[np.newaxis], one.z[np.newaxis])
    gradient = view.by_pose[0].T @ view.residual[0]
    information = view.by_pose[0].T @ view.by_pose[0]
    assert gradient @ np.linalg.solve(information, gradient) < 1e-8  # squared, in standard deviations


def test_many_maps_together_have_the_poses_that_each_has_alone() -> None:
    one, rng = scene(3), np.random.default_rng(3)
    maps = one.points + 0.05 * rng.normal(size=(20, 32, 3))
    starts = near(one.truth).retract(0.02 * rng.normal(size=(20, 6)))
    together = maximum_likelihood(CAMERA, maps, one.z, starts)
    assert together.found.all()
    for k in range(20):
        alone = maximum_likelihood(CAMERA, maps[k : k + 1], one.z, starts.take(np.array([k])))
        assert np.allclose(alone.poses.minus(together.poses.take(np.array([k]))), 0.0, atol=1e-9)


def test_a_pose_that_cannot_be_found_is_told_beside_those_that_are() -> None:
    one = scene(4)
    away = Poses(exp(np.array([0.0, 0.0, np.pi])) @ one.truth.rotation, one.truth.position)  # looks outwards
    starts = Poses(np.stack([away.rotation, one.truth.rotation]), np.stack([away.position, one.truth.position]))
    maps = np.stack([one.points, one.points])
    found = maximum_likelihood(CAMERA, maps, one.z, starts, rounds=8)
    assert found.found.tolist() == [False, True]


# -- one update ----------------------------------------------------------------------------------


def closed_form(one: Scene, pose: Poses) -> Floats:
    """The posterior covariance of pose and map under a flat prior on the pose: (HᵀR⁻¹H + diag(0, P⁻¹))⁻¹."""
    view = view_at(one.camera, one.belief, pose, one.z, np.arange(32))
    assert view is not None
    H = np.hstack([view.by_pose, view.by_map])
    information = H.T @ H
    information[6:, 6:] += np.linalg.inv(one.belief.covariance)
    return np.asarray(np.linalg.inv(information))


def test_the_ekf_is_the_closed_form_under_a_flat_prior_on_the_pose() -> None:
    one = scene(5)
    found = updated(extended, one)
    fit = maximum_likelihood(one.camera, one.belief.points[np.newaxis], one.z, one.truth.repeat(1))
    pose = fit.poses.take(0)
    P = closed_form(one, pose)
    view = view_at(one.camera, one.belief, pose, one.z, np.arange(32))
    assert view is not None
    step = P @ np.hstack([view.by_pose, view.by_map]).T @ view.residual
    assert found.pose is not None
    assert found.covariance is not None
    assert np.allclose(found.covariance, P, rtol=0, atol=1e-10 * np.abs(P).max() * 1e2)
    assert np.allclose(found.belief.points, one.belief.points + step[6:].reshape(-1, 3), rtol=0, atol=1e-9)
    assert np.allclose(found.pose.minus(pose), step[:6], rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", ["linear", "likelihood"])
def test_where_the_world_is_nearly_linear_second_and_third_ukf_are_the_ekf(name: str) -> None:
    """Errors of 1e-7 m leave a nonlinearity of some 1e-14: EKF, both UKFs and the closed form agree to 1e-10."""
    one = scene(6, sigma=1e-7, noise=1e-4)
    ekf, ukf = updated(extended, one), updated(EXACT[name], one)
    assert ekf.pose is not None
    assert ukf.pose is not None
    assert ekf.covariance is not None
    assert ukf.covariance is not None
    assert np.allclose(ukf.belief.points, ekf.belief.points, rtol=0, atol=1e-10)
    assert np.allclose(ukf.pose.minus(ekf.pose), 0.0, rtol=0, atol=1e-10)
    scale = np.sqrt(np.diag(ekf.covariance))
    assert np.allclose((ukf.covariance - ekf.covariance) / np.outer(scale, scale), 0.0, atol=1e-5)
    P = closed_form(one, ekf.pose)
    assert np.allclose((P - ekf.covariance) / np.outer(scale, scale), 0.0, atol=1e-5)


def test_a_constant_pose_loses_uncertainty_that_the_others_keep() -> None:
    """Its gain takes the view as if the pose were known (eq. 22): eq. 17 without what the pose takes up."""
    one = scene(7)
    kept, lost = updated(extended, one).belief.covariance, updated(FILTERS["constant"], one).belief.covariance
    assert np.linalg.eigvalsh(kept - lost)[0] > -1e-4 * kept.max()
    assert np.linalg.slogdet(kept)[1] - np.linalg.slogdet(lost)[1] > 10.0  # six directions' worth
    view = view_at(one.camera, one.belief, one.truth, one.z, np.arange(32))
    assert view is not None
    S = view.by_map @ one.belief.covariance @ view.by_map.T + np.eye(64)
    K = one.belief.covariance @ view.by_map.T @ np.linalg.inv(S)
    assert np.allclose(lost, one.belief.covariance - K @ S @ K.T, atol=0.02 * lost.max())


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("scaling", [Scaling(1.0), Scaling(0.1), Scaling(1e-3)])
def test_pose_and_map_stay_positive_definite_with_the_pose_no_surer_than_its_view(name: str, scaling: Scaling) -> None:
    """Eq. 19 as corrected: before the update the pose has (HₓᵀR⁻¹Hₓ)⁻¹ and the spread; after it keeps the first."""
    chosen = FILTERS[name]
    filter_ = Unscented(chosen.poses, scaling) if isinstance(chosen, Unscented) else chosen
    one = scene(8, sigma=0.05)
    fit = maximum_likelihood(one.camera, one.belief.points[np.newaxis], one.z, one.truth.repeat(1))
    view = view_at(one.camera, one.belief, fit.poses.take(0), one.z, np.arange(32))
    assert view is not None
    prior = filter_(one.camera, one.belief, view)
    assert isinstance(prior, Moments)
    found = update(filter_, one.camera, one.belief, one.z, near(one.truth))
    assert found.covariance is not None
    for covariance in (prior.covariance, found.covariance):
        assert np.linalg.eigvalsh(covariance)[0] > 0.0
        assert np.linalg.eigvalsh(covariance[:6, :6] - view.own)[0] > -1e-12
    assert np.array_equal(found.belief.covariance, found.covariance[6:, 6:])


def test_points_that_are_not_seen_move_with_those_that_are_and_their_order_is_nothing() -> None:
    one, rng = scene(9), np.random.default_rng(9)
    factor = rng.normal(size=(96, 96))
    belief = Belief(one.belief.points, 1e-6 * factor @ factor.T + 1e-5 * np.eye(96))
    seen = np.array([3, 30, 7, 12, 0, 21, 25, 9])
    for filter_ in FILTERS.values():
        some = update(filter_, one.camera, belief, one.z[seen], near(one.truth), seen)
        again = update(filter_, one.camera, belief, one.z[seen[::-1]], near(one.truth), seen[::-1])
        assert some.status is Status.done
        assert np.allclose(some.belief.points, again.belief.points, atol=1e-9)
        assert np.allclose(some.belief.covariance, again.belief.covariance, atol=1e-12)
        hidden = np.setdiff1d(np.arange(32), seen)
        assert np.abs(some.belief.points - belief.points)[hidden].max() > 1e-5


# -- many runs -----------------------------------------------------------------------------------


def test_covariances_tell_the_truth_but_for_a_constant_pose() -> None:
    """Eq. 27 after six views around the points, and the last pose's NEES, over eight runs: 99.9 % bounds of χ²."""
    views, runs, world = np.arange(0, 48, 8), 8, spiral()
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in FILTERS}
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        z = observe(world, CAMERA, rng)
        start = noisy(world.points, 0.01, rng)
        for name, filter_ in FILTERS.items():
            belief, after = start, Update(start, Status.no_pose)
            for k in views:
                after = update(filter_, CAMERA, belief, z[k], world.poses.take(int(k)))
                belief = after.belief
            assert after.pose is not None
            assert after.covariance is not None
            error = world.poses.take(int(views[-1])).minus(after.pose)
            found[name].append((mahalanobis(belief, world.points), nees(error, after.covariance[:6, :6]) / 6.0))
    for name, values in found.items():
        of_map, of_pose = np.mean(values, axis=0)
        low, high = average_bounds(0.999, 96, runs)
        if name == "constant":
            assert of_map > 2.0
            continue
        assert low < of_map < high
        low, high = average_bounds(0.999, 6, runs)
        assert low < of_pose < high


# -- what goes wrong -----------------------------------------------------------------------------


def test_a_covariance_that_is_none_is_told() -> None:
    one = scene(10)
    broken = Belief(one.belief.points, one.belief.covariance - 2e-4 * np.eye(96)[0][:, np.newaxis] * np.eye(96)[0])
    for filter_ in FILTERS.values():
        found = update(filter_, one.camera, broken, one.z, near(one.truth))
        assert found.status is Status.not_positive
        assert found.belief is broken
        assert found.pose is None


@pytest.mark.parametrize("seen", [[0, 5], [0]])
def test_a_view_of_too_few_points_has_no_pose(seen: list[int]) -> None:
    one = scene(11)
    found = update(extended, one.camera, one.belief, one.z[seen], near(one.truth), np.array(seen))
    assert found.status is Status.no_pose
    assert found.belief is one.belief


@pytest.mark.parametrize("name", ["constant", "linear", "likelihood"])
def test_sigma_points_behind_the_camera_are_told(name: str) -> None:
    one = scene(12)
    vague = Belief(one.points, 25.0 * np.eye(96))
    filter_ = FILTERS[name]
    assert isinstance(filter_, Unscented)
    found = update(Unscented(filter_.poses, Scaling(1.0)), one.camera, vague, one.z, one.truth)
    assert found.status is Status.no_sigma_pose
    assert found.belief is vague


def test_a_measurement_of_the_wrong_shape_is_refused() -> None:
    one = scene(13)
    for z, seen in ((one.z[:5], None), (one.z, np.arange(5)), (one.z * np.nan, None)):
        with pytest.raises(MeasurementError, match=r"expected finite"):
            update(extended, one.camera, one.belief, z, one.truth, seen)
