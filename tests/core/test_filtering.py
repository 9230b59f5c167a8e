"""The compiled filter against a dense one with numeric Jacobians, and what it does with bad readings."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from submaps.consistency import chi_square_bound
from submaps.filtering import kernel
from submaps.filtering.layout import OBSERVATIONS, REJECTED
from submaps.observation.models import MODELS
from tests.core.support import MOUNT, DenseFilter, Kernel, random_covariance, seen, wrapped

Floats = NDArray[np.float64]
both_filters = pytest.mark.parametrize("invariant", [True, False], ids=["invariant", "standard"])
both_models = pytest.mark.parametrize("model", sorted(MODELS))


def generic(seed: int, landmarks: int = 4) -> tuple[Floats, Floats]:
    """A state whose landmarks are some metres off, with a full covariance."""
    rng = np.random.default_rng(seed)
    n = 3 + 2 * landmarks
    x = rng.normal(size=n)
    angle = rng.uniform(0, 2 * np.pi, size=landmarks)
    x[3::2], x[4::2] = x[0] + 8.0 * np.cos(angle), x[1] + 8.0 * np.sin(angle)
    x[2] = rng.uniform(-3.0, 3.0)
    return x, random_covariance(rng, n, 0.1)


def pair(invariant: bool, model: str, seed: int) -> tuple[Kernel, DenseFilter]:
    """The compiled filter and the dense one, in the same generic state."""
    x, P = generic(seed)
    compiled = Kernel(invariant, model)
    compiled.set(x, P)
    return compiled, DenseFilter(x, P, invariant, model, MOUNT)


def assert_equal(compiled: Kernel, dense: DenseFilter, tolerance: float = 1e-9) -> None:
    difference = compiled.x - dense.x
    difference[2] = wrapped(difference[2])
    assert np.abs(difference).max() < tolerance
    scale = np.sqrt(np.outer(np.diag(dense.P), np.diag(dense.P)))
    assert np.max(np.abs(compiled.P - dense.P) / scale) < tolerance
    assert np.array_equal(compiled.P, compiled.P.T)


@both_filters
@pytest.mark.parametrize("seed", range(4))
def test_prediction(invariant: bool, seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    compiled, dense = pair(invariant, "cartesian", seed)
    increment, noise = rng.normal(size=3), random_covariance(rng, 3, 0.1)
    compiled.step(increment, noise, [], np.eye(2))
    compiled.predict(invariant)
    dense.predict(increment, noise)
    assert_equal(compiled, dense)


@both_filters
def test_prediction_with_a_heading_known_for_certain(invariant: bool) -> None:
    compiled, dense = pair(invariant, "cartesian", 5)
    noise = np.zeros((3, 3))
    noise[:2, :2] = random_covariance(np.random.default_rng(5), 2, 0.1)
    compiled.step(np.array([1.0, 0.2, 0.3]), noise, [], np.eye(2))
    compiled.predict(invariant)
    dense.predict(np.array([1.0, 0.2, 0.3]), noise)
    assert_equal(compiled, dense)


@both_filters
@both_models
@pytest.mark.parametrize("seed", range(3))
def test_update(invariant: bool, model: str, seed: int) -> None:
    rng = np.random.default_rng(200 + seed)
    compiled, dense = pair(invariant, model, seed)
    R = random_covariance(rng, 2, 0.1)
    for landmark in (2, 0):
        slot = 3 + 2 * landmark
        z = seen(model, MOUNT, dense.x, slot) + rng.normal(size=2) * 0.2
        status, nis = compiled.step(None, None, [(landmark, z)], R)
        expected = dense.update(slot, z, R)
        assert status[0] in (kernel.USED, kernel.FLAGGED)
        assert nis[0] == pytest.approx(expected, rel=1e-7)
        assert_equal(compiled, dense)


@both_filters
@both_models
def test_augmentation(invariant: bool, model: str) -> None:
    compiled, dense = pair(invariant, model, 7)
    R = random_covariance(np.random.default_rng(7), 2, 0.1)
    z = np.array([4.0, 0.7])
    status, nis = compiled.step(None, None, [(9, z)], R)
    dense.augment(z, R)
    assert status == [kernel.FIRST]
    assert math.isnan(nis[0])
    assert compiled.submap.landmark_count == 5
    assert_equal(compiled, dense)


@both_filters
@both_models
def test_a_drive(invariant: bool, model: str) -> None:
    """Prediction riding on the update that follows, new landmarks in between, over and over."""
    rng = np.random.default_rng(8)
    compiled, dense = pair(invariant, model, 8)
    R = random_covariance(rng, 2, 0.2)
    slots = {i: 3 + 2 * i for i in range(4)}
    for k in range(12):
        increment, noise = rng.normal(size=3) * 0.3, random_covariance(rng, 3, 0.03)
        sightings = []
        dense.predict(increment, noise)
        for landmark in rng.permutation(5 + k // 3)[: 1 + k % 3]:
            if int(landmark) in slots:
                z = seen(model, MOUNT, dense.x, slots[int(landmark)]) + rng.normal(size=2) * 0.1
                dense.update(slots[int(landmark)], z, R)
            else:
                z = np.array([5.0 + k, 0.2 * k])
                slots[int(landmark)] = dense.x.shape[0]
                dense.augment(z, R)
            sightings.append((int(landmark), z))
        compiled.step(increment, noise, sightings, R)
        assert_equal(compiled, dense, 1e-8)
    assert len(slots) > 5


def test_both_filters_are_one_on_a_linear_world() -> None:
    """With the heading known there is nothing for the two errors to disagree on."""
    rng = np.random.default_rng(9)
    a, b = Kernel(True, "cartesian"), Kernel(False, "cartesian")
    noise = np.diag([0.1, 0.2, 0.0])
    for _ in range(20):
        sightings = [(int(i), rng.normal(size=2) * 5.0) for i in rng.permutation(6)[:2]]
        for one in (a, b):
            one.step(np.array([0.5, 0.1, 0.3]), noise, sightings, np.eye(2) * 0.1)
    assert np.allclose(a.x, b.x, atol=1e-12)
    assert np.allclose(a.P, b.P, atol=1e-12)


@both_filters
@both_models
def test_a_gated_reading_leaves_the_state_alone(invariant: bool, model: str) -> None:
    x, P = generic(10)
    far = seen(model, MOUNT, x, 3) + (3.0, 1.0)
    quiet, gated = Kernel(invariant, model, gate=9.21), Kernel(invariant, model, gate=9.21)
    quiet.set(x, P)
    gated.set(x, P)
    increment, noise = np.array([0.1, 0.0, 0.05]), np.diag([1e-4, 1e-4, 1e-5])
    quiet.step(increment, noise, [], np.eye(2) * 0.01)
    quiet.predict(invariant)
    status, nis = gated.step(increment, noise, [(0, far)], np.eye(2) * 0.01)
    assert status == [kernel.GATED]
    assert nis[0] > 9.21
    assert np.array_equal(gated.x, quiet.x)
    assert np.array_equal(gated.P, quiet.P)
    assert gated.submap.counts[REJECTED] == 1
    assert gated.submap.counts[OBSERVATIONS] == 0


@both_filters
@both_models
@pytest.mark.parametrize("z", [(math.nan, 1.0), (1.0, math.nan), (math.inf, 1.0), (1.0, -math.inf), (1e200, 1.0)])
@pytest.mark.parametrize("landmark", [0, 9], ids=["known", "new"])
def test_a_reading_that_is_not_finite_is_reported(
    invariant: bool, model: str, z: tuple[float, float], landmark: int
) -> None:
    x, P = generic(11)
    compiled = Kernel(invariant, model)
    compiled.set(x, P)
    if z[0] == 1e200 and landmark == 9:
        z = (1e308, math.nan)
    status, _ = compiled.step(None, None, [(landmark, np.array(z))], np.eye(2) * 0.01)
    assert status == [kernel.SINGULAR]
    assert np.array_equal(compiled.x, x)
    assert np.array_equal(compiled.P, P)


@both_filters
def test_standing_on_a_landmark_is_reported_and_the_next_reading_used(invariant: bool) -> None:
    x, P = generic(12)
    mount = (0.0, 0.0, 0.0)
    x[3:5] = x[:2]
    compiled = Kernel(invariant, "range_bearing", mount=mount)
    compiled.set(x, P)
    good = seen("range_bearing", mount, x, 5) + (0.01, 0.001)
    status, nis = compiled.step(None, None, [(0, np.array([0.1, 0.2])), (1, good)], np.diag([0.01, 1e-4]))
    assert status == [kernel.SINGULAR, kernel.USED]
    assert math.isnan(nis[0])
    dense = DenseFilter(x, P, invariant, "range_bearing", mount)
    dense.update(5, good, np.diag([0.01, 1e-4]))
    assert_equal(compiled, dense)


@both_filters
def test_an_innovation_without_rank_is_reported(invariant: bool) -> None:
    """Two readings of one landmark with no noise left: the second has nothing to divide by."""
    x, _ = generic(13)
    compiled = Kernel(invariant, "cartesian")
    compiled.set(x, np.zeros((11, 11)))
    R = np.array([[1.0, 1.0], [1.0, 1.0]])
    status, _ = compiled.step(None, None, [(0, seen("cartesian", MOUNT, x, 3))], R)
    assert status == [kernel.SINGULAR]
    assert np.array_equal(compiled.x, x)


@both_filters
def test_an_unlikely_reading_is_used_and_flagged(invariant: bool) -> None:
    compiled, dense = pair(invariant, "cartesian", 14)
    R = np.eye(2) * 0.01
    z = seen("cartesian", MOUNT, dense.x, 3) + (1.5, 1.5)
    status, nis = compiled.step(None, None, [(0, z)], R)
    assert status == [kernel.FLAGGED]
    assert nis[0] > chi_square_bound(0.9999, 2)
    dense.update(3, z, R)
    assert_equal(compiled, dense)


@both_filters
def test_a_bearing_behind_the_robot_updates_the_short_way(invariant: bool) -> None:
    x = np.array([0.0, 0.0, 0.0, -5.0, -0.01])
    compiled = Kernel(invariant, "range_bearing", mount=(0.0, 0.0, 0.0))
    compiled.set(x, np.eye(5) * 0.01)
    status, nis = compiled.step(None, None, [(0, np.array([5.0, math.pi - 0.002]))], np.diag([0.01, 0.01]))
    assert status == [kernel.USED]
    assert nis[0] < 0.01
