"""Two calibrated cameras: depth, epipolar matrices, and the motion between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from submaps.errors import MeasurementError
from submaps.vision.depth import depth, depth_by_component, homogeneous, reconstruct
from submaps.vision.epipolar import (
    essential_matrix,
    fundamental_matrix,
    motions,
    normalised,
    relative_pose,
)

Floats = NDArray[np.float64]

K = np.array([[600.0, 0.0, 320.0], [0.0, 580.0, 240.0], [0.0, 0.0, 1.0]])
K_TWO = np.array([[450.0, 2.0, 300.0], [0.0, 455.0, 260.0], [0.0, 0.0, 1.0]])


def skew(v: Floats) -> Floats:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def rotation(seed: int, angle: float) -> Floats:
    """Rodrigues' formula about a random axis."""
    axis = np.random.default_rng(seed).normal(size=3)
    S = skew(axis / np.linalg.norm(axis))
    return np.asarray(np.eye(3) + np.sin(angle) * S + (1.0 - np.cos(angle)) * S @ S)


@dataclass(frozen=True)
class Pair:
    """Points in camera one's frame, X' = R (X − t), and what both see."""

    R: Floats
    t: Floats
    X: Floats

    @property
    def y(self) -> Floats:
        return self.X[:, :2] / self.X[:, 2:]

    @property
    def y_two(self) -> Floats:
        moved = (self.X - self.t) @ self.R.T
        return np.asarray(moved[:, :2] / moved[:, 2:])


def pair(seed: int, count: int = 30) -> Pair:
    rng = np.random.default_rng(seed)
    X = rng.uniform((-2.0, -2.0, 4.0), (2.0, 2.0, 9.0), (count, 3))
    return Pair(rotation(seed, 0.2), rng.uniform(-0.8, 0.8, 3), X)


def pixels(y: Floats, calibration: Floats) -> Floats:
    return np.asarray((homogeneous(y) @ calibration.T)[:, :2])


@pytest.mark.parametrize("seed", range(5))
def test_depth_is_the_closed_form_by_either_component_and_by_both(seed: int) -> None:
    two = pair(seed)
    for found in (
        depth_by_component(two.R, two.t, two.y, two.y_two, 0),
        depth_by_component(two.R, two.t, two.y, two.y_two, 1),
        depth(two.R, two.t, two.y, two.y_two),
    ):
        assert np.allclose(found, two.X[:, 2], rtol=1e-9)
    assert np.allclose(reconstruct(two.R, two.t, two.y, two.y_two), two.X, rtol=1e-9)


def test_a_translated_scale_scales_the_points() -> None:
    two = pair(1)
    assert np.allclose(reconstruct(two.R, 3.0 * two.t, two.y, two.y_two), 3.0 * two.X)


def test_one_camera_above_the_other_leaves_the_depth_to_the_second_component() -> None:
    """The lecture's quotient is 0/0 for every point there."""
    two = Pair(np.eye(3), np.array([0.0, 0.5, 0.0]), pair(2).X)
    assert np.all(np.isnan(depth_by_component(two.R, two.t, two.y, two.y_two, 0)))
    assert np.allclose(depth_by_component(two.R, two.t, two.y, two.y_two, 1), two.X[:, 2])
    assert np.allclose(depth(two.R, two.t, two.y, two.y_two), two.X[:, 2])


def test_what_lies_on_the_line_through_both_cameras_or_at_infinity_has_no_depth() -> None:
    forward = np.array([0.0, 0.0, 1.0])
    assert np.isnan(depth(np.eye(3), forward, np.zeros((1, 2)), np.zeros((1, 2))))[0]
    sideways, far = np.array([1.0, 0.0, 0.0]), np.array([[0.1, 0.2]])
    assert np.isnan(depth(np.eye(3), sideways, far, far))[0]


@pytest.mark.parametrize("seed", range(5))
def test_the_fundamental_matrix_fits_every_correspondence_and_has_rank_two(seed: int) -> None:
    two = pair(seed)
    x, x_two = pixels(two.y, K), pixels(two.y_two, K_TWO)
    F = fundamental_matrix(x, x_two)
    lines = homogeneous(x) @ F.T
    distance = np.abs(np.sum(homogeneous(x_two) * lines, axis=1)) / np.hypot(lines[:, 0], lines[:, 1])
    assert distance.max() < 1e-8  # pixels from the epipolar line
    assert np.linalg.svd(F)[1][2] < 1e-15
    assert np.linalg.norm(F) == pytest.approx(1.0)


@pytest.mark.parametrize("seed", range(5))
def test_the_essential_matrix_is_that_of_the_motion(seed: int) -> None:
    two = pair(seed)
    E = essential_matrix(fundamental_matrix(pixels(two.y, K), pixels(two.y_two, K_TWO)), K, K_TWO)
    assert np.allclose(np.linalg.svd(E)[1], (1.0, 1.0, 0.0), atol=1e-14)
    true = two.R @ skew(two.t / np.linalg.norm(two.t))
    assert min(np.abs(E - true).max(), np.abs(E + true).max()) < 1e-8
    assert np.allclose(2.0 * E @ E.T @ E, np.trace(E @ E.T) * E, atol=1e-13)  # Hartley & Zisserman, eq. 9.13's law


@pytest.mark.parametrize("seed", range(8))
def test_rotation_and_translation_come_back_and_the_baseline_gives_the_scale(seed: int) -> None:
    two = pair(seed)
    x, x_two = pixels(two.y, K), pixels(two.y_two, K_TWO)
    y, y_two = normalised(x, K), normalised(x_two, K_TWO)
    assert np.allclose(y, two.y)
    found = relative_pose(essential_matrix(fundamental_matrix(x, x_two), K, K_TWO), y, y_two)
    assert found.before_both == len(two.X)
    assert np.linalg.norm(found.translation) == pytest.approx(1.0)
    known = found.scaled(float(np.linalg.norm(two.t)))
    assert np.allclose(known.rotation, two.R, atol=1e-8)
    assert np.allclose(known.translation, two.t, atol=1e-8)
    assert np.allclose(reconstruct(known.rotation, known.translation, y, y_two), two.X, rtol=1e-6)


def test_four_motions_mean_the_same_matrix_and_one_has_the_points_before_both() -> None:
    two = pair(3)
    E = two.R @ skew(two.t / np.linalg.norm(two.t))
    before = []
    for R, t in motions(E):
        assert np.allclose(R @ R.T, np.eye(3), atol=1e-13)
        assert np.linalg.det(R) == pytest.approx(1.0)
        assert min(np.abs(R @ skew(t) - E).max(), np.abs(R @ skew(t) + E).max()) < 1e-12
        x3 = depth(R, t, two.y, two.y_two)
        x3_two = (homogeneous(two.y) * x3[:, np.newaxis] - t) @ R[2]
        before.append(bool(np.all((x3 > 0.0) & (x3_two > 0.0))))
    assert sorted(before) == [False, False, False, True]


def test_what_cannot_tell_the_matrix_is_refused() -> None:
    two = pair(4)
    flat = Pair(two.R, two.t, np.column_stack([two.X[:, :2], 0.3 * two.X[:, 0] + 5.0]))
    with pytest.raises(MeasurementError, match="one plane"):
        fundamental_matrix(flat.y, flat.y_two)
    with pytest.raises(MeasurementError, match="no motion"):
        fundamental_matrix(two.y, two.y)
    with pytest.raises(MeasurementError, match="at least 8"):
        fundamental_matrix(two.y[:7], two.y_two[:7])
    with pytest.raises(MeasurementError, match="not finite"):
        fundamental_matrix(np.where(two.y == two.y[0], np.nan, two.y), two.y_two)
