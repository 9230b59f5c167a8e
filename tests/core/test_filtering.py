"""The compiled filter against a dense one with numeric Jacobians, and what it does with bad readings."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from submaps.config import ObservationConfig
from submaps.consistency import chi_square_bound
from submaps.filtering import kernel
from submaps.filtering.layout import OBSERVATIONS, REJECTED
from submaps.geometry.space import PLANE, SOLID, Space
from tests.core.filters import SENSORS, DenseFilter, Kernel, minus, rotation, seen, space_of
from tests.core.support import random_covariance

Floats = NDArray[np.float64]
both_filters = pytest.mark.parametrize("invariant", [True, False], ids=["invariant", "standard"])
every_model = pytest.mark.parametrize("model", sorted(SENSORS))
both_spaces = pytest.mark.parametrize("model", ["cartesian", "cartesian3d"], ids=["plane", "space"])


def ahead(space: Space, x: Floats, rng: np.random.Generator) -> Floats:
    """A point some metres from the robot, in space where a camera sees it."""
    if space.dim == 2:
        angle = rng.uniform(0, 2 * np.pi)
        return np.asarray(x[:2] + 8.0 * np.array([np.cos(angle), np.sin(angle)]))
    body = np.array([rng.uniform(6.0, 10.0), *rng.uniform(-2.0, 2.0, 2)])
    return np.asarray(x[:3] + rotation(space, x[3:6]) @ body)


def generic(space: Space, seed: int, landmarks: int = 4) -> tuple[Floats, Floats]:
    """A state whose landmarks are some metres off, with a full covariance."""
    rng = np.random.default_rng(seed)
    x = np.concatenate([rng.normal(size=space.dim), rng.uniform(-1.5, 1.5, space.rot)])
    x = np.concatenate([x, *(ahead(space, x, rng) for _ in range(landmarks))])
    return x, random_covariance(rng, x.shape[0], 0.1 if space.dim == 2 else 0.05)


def pair(invariant: bool, model: str, seed: int) -> tuple[Kernel, DenseFilter]:
    """The compiled filter and the dense one, in the same generic state."""
    x, P = generic(space_of(SENSORS[model]), seed)
    compiled = Kernel(invariant, SENSORS[model])
    compiled.set(x, P)
    return compiled, DenseFilter(x, P, invariant, SENSORS[model])


def noise_of(sensor: ObservationConfig, rng: np.random.Generator, scale: float = 1.0) -> Floats:
    """A full covariance of a reading, about as large as the sensor's own."""
    channels = len(sensor.channels)
    D = np.diag(sensor.sigma) * scale
    return np.asarray(D @ random_covariance(rng, channels) @ D)


def assert_equal(compiled: Kernel, dense: DenseFilter, tolerance: float = 1e-8) -> None:
    assert np.abs(minus(dense.space, compiled.x, dense.x, False)).max() < tolerance
    scale = np.sqrt(np.outer(np.diag(dense.P), np.diag(dense.P)))
    assert np.max(np.abs(compiled.P - dense.P) / scale) < tolerance
    assert np.array_equal(compiled.P, compiled.P.T)


@both_filters
@both_spaces
@pytest.mark.parametrize("seed", range(3))
def test_prediction(invariant: bool, model: str, seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    compiled, dense = pair(invariant, model, seed)
    pose = compiled.space.pose
    increment, noise = rng.normal(size=pose), random_covariance(rng, pose, 0.1)
    compiled.step(increment, noise, [], np.eye(compiled.channels))
    compiled.predict()
    dense.predict(increment, noise)
    assert_equal(compiled, dense)


@both_filters
@both_spaces
def test_prediction_with_a_rotation_known_for_certain(invariant: bool, model: str) -> None:
    compiled, dense = pair(invariant, model, 5)
    space = compiled.space
    noise = np.zeros((space.pose, space.pose))
    noise[: space.dim, : space.dim] = random_covariance(np.random.default_rng(5), space.dim, 0.1)
    increment = np.linspace(0.2, 0.9, space.pose)
    compiled.step(increment, noise, [], np.eye(compiled.channels))
    compiled.predict()
    dense.predict(increment, noise)
    assert_equal(compiled, dense)


@both_filters
@both_spaces
def test_increments_compose_to_what_each_in_turn_predicts(invariant: bool, model: str) -> None:
    rng = np.random.default_rng(6)
    compiled, dense = pair(invariant, model, 6)
    pose = compiled.space.pose
    for _ in range(5):
        increment, noise = rng.normal(size=pose) * 0.3, random_covariance(rng, pose, 0.02)
        compiled.step(increment, noise, [], np.eye(compiled.channels))
        dense.predict(increment, noise)
    compiled.predict()
    assert_equal(compiled, dense)


@both_filters
@every_model
@pytest.mark.parametrize("seed", range(3))
def test_update(invariant: bool, model: str, seed: int) -> None:
    rng = np.random.default_rng(200 + seed)
    compiled, dense = pair(invariant, model, seed)
    sensor, space = SENSORS[model], compiled.space
    R = noise_of(sensor, rng)
    for landmark in (2, 0):
        slot = space.pose + space.dim * landmark
        z = seen(sensor, dense.x, slot) + rng.normal(size=compiled.channels) * sensor.sigma
        status, nis = compiled.step(None, None, [(landmark, z)], R)
        expected = dense.update(slot, z, R)
        assert status[0] in (kernel.USED, kernel.FLAGGED)
        assert nis[0] == pytest.approx(expected, rel=1e-7)
        assert_equal(compiled, dense)


@both_filters
@every_model
def test_augmentation(invariant: bool, model: str) -> None:
    compiled, dense = pair(invariant, model, 7)
    sensor, rng = SENSORS[model], np.random.default_rng(7)
    R = noise_of(sensor, rng)
    z = seen(sensor, np.append(dense.x, ahead(compiled.space, dense.x, rng)), dense.x.shape[0])
    status, nis = compiled.step(None, None, [(9, z)], R)
    dense.augment(z, R)
    assert status == [kernel.FIRST]
    assert math.isnan(nis[0])
    assert compiled.submap.landmark_count == 5
    assert_equal(compiled, dense)


@both_filters
@every_model
def test_a_drive(invariant: bool, model: str) -> None:
    """Prediction riding on the update that follows, new landmarks in between, over and over."""
    rng = np.random.default_rng(8)
    compiled, dense = pair(invariant, model, 8)
    sensor, space = SENSORS[model], compiled.space
    R = noise_of(sensor, rng, 2.0)
    slots = {i: space.pose + space.dim * i for i in range(4)}
    for k in range(12):
        increment, noise = rng.normal(size=space.pose) * 0.1, random_covariance(rng, space.pose, 0.01)
        sightings = []
        dense.predict(increment, noise)
        for landmark in map(int, rng.permutation(5 + k // 3)[: 1 + k % 3]):
            if landmark in slots:
                z = seen(sensor, dense.x, slots[landmark])
                if not np.isfinite(z).all():
                    continue
                z = z + rng.normal(size=compiled.channels) * sensor.sigma
                dense.update(slots[landmark], z, R)
            else:
                point = ahead(space, dense.x, rng)
                slots[landmark] = dense.x.shape[0]
                z = seen(sensor, np.append(dense.x, point), slots[landmark])
                dense.augment(z, R)
            sightings.append((landmark, z))
        compiled.step(increment, noise, sightings, R)
        assert_equal(compiled, dense, 1e-7)
    assert len(slots) > 5


@pytest.mark.parametrize("space", [PLANE, SOLID], ids=["plane", "space"])
def test_both_filters_are_one_on_a_linear_world(space: Space) -> None:
    """With the rotation known there is nothing for the two errors to disagree on."""
    rng = np.random.default_rng(9)
    sensor = SENSORS["cartesian" if space.dim == 2 else "cartesian3d"]
    a, b = Kernel(True, sensor), Kernel(False, sensor)
    noise = np.diag([*np.linspace(0.1, 0.2, space.dim), *np.zeros(space.rot)])
    for _ in range(20):
        sightings = [(int(i), rng.normal(size=space.dim) * 5.0) for i in rng.permutation(6)[:2]]
        for one in (a, b):
            one.step(np.linspace(0.5, 0.1, space.pose), noise, sightings, np.eye(space.dim) * 0.1)
    assert np.allclose(a.x, b.x, atol=1e-11)
    assert np.allclose(a.P, b.P, atol=1e-12)


@both_filters
@every_model
def test_a_gated_reading_leaves_the_state_alone(invariant: bool, model: str) -> None:
    sensor, space = SENSORS[model], space_of(SENSORS[model])
    x, P = generic(space, 10)
    far = seen(sensor, x, space.pose) + (100.0 if sensor.camera else 2.5)
    quiet, gated = Kernel(invariant, sensor, gate=9.21), Kernel(invariant, sensor, gate=9.21)
    quiet.set(x, P * 0.1)
    gated.set(x, P * 0.1)
    increment, noise = np.full(space.pose, 0.02), np.eye(space.pose) * 1e-5
    R = np.diag(np.square(sensor.sigma)) * 0.1
    quiet.step(increment, noise, [], R)
    quiet.predict()
    status, nis = gated.step(increment, noise, [(0, far)], R)
    assert status == [kernel.GATED]
    assert nis[0] > 9.21
    assert np.array_equal(gated.x, quiet.x)
    assert np.array_equal(gated.P, quiet.P)
    assert gated.submap.counts[REJECTED] == 1
    assert gated.submap.counts[OBSERVATIONS] == 0


@both_filters
@every_model
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("landmark", [0, 9], ids=["known", "new"])
def test_a_reading_that_is_not_finite_is_reported(invariant: bool, model: str, bad: float, landmark: int) -> None:
    sensor = SENSORS[model]
    x, P = generic(space_of(sensor), 11)
    for channel in range(len(sensor.channels)):
        compiled = Kernel(invariant, sensor)
        compiled.set(x, P)
        z = np.linspace(300.0, 200.0, compiled.channels)
        z[channel] = bad
        status, _ = compiled.step(None, None, [(landmark, z)], np.eye(compiled.channels) * 0.01)
        assert status == [kernel.SINGULAR]
        assert np.array_equal(compiled.x, x)
        assert np.array_equal(compiled.P, P)


@both_filters
def test_a_reading_that_overflows_is_reported(invariant: bool) -> None:
    for model in ("cartesian", "range_bearing", "cartesian3d"):
        x, P = generic(space_of(SENSORS[model]), 11)
        compiled = Kernel(invariant, SENSORS[model])
        compiled.set(x, P)
        z = np.full(compiled.channels, 1e200)
        status, _ = compiled.step(None, None, [(0, z)], np.eye(compiled.channels) * 0.01)
        assert status == [kernel.SINGULAR]
        assert np.array_equal(compiled.x, x)


@both_filters
def test_standing_on_a_landmark_is_reported_and_the_next_reading_used(invariant: bool) -> None:
    x, P = generic(PLANE, 12)
    sensor = replace(SENSORS["range_bearing"], mount=(0.0, 0.0, 0.0))
    x[3:5] = x[:2]
    compiled = Kernel(invariant, sensor)
    compiled.set(x, P)
    good = seen(sensor, x, 5) + (0.01, 0.001)
    status, nis = compiled.step(None, None, [(0, np.array([0.1, 0.2])), (1, good)], np.diag([0.01, 1e-4]))
    assert status == [kernel.SINGULAR, kernel.USED]
    assert math.isnan(nis[0])
    dense = DenseFilter(x, P, invariant, sensor)
    dense.update(5, good, np.diag([0.01, 1e-4]))
    assert_equal(compiled, dense)


@both_filters
@both_spaces
def test_an_innovation_without_rank_is_reported(invariant: bool, model: str) -> None:
    """A reading that knows one direction for certain, of a state with no noise left: nothing to divide by."""
    sensor, space = SENSORS[model], space_of(SENSORS[model])
    x, _ = generic(space, 13)
    compiled = Kernel(invariant, sensor)
    compiled.set(x, np.zeros((x.shape[0], x.shape[0])))
    R = np.ones((space.dim, space.dim))
    status, _ = compiled.step(None, None, [(0, seen(sensor, x, space.pose))], R)
    assert status == [kernel.SINGULAR]
    assert np.array_equal(compiled.x, x)


@both_filters
@both_spaces
def test_an_unlikely_reading_is_used_and_flagged(invariant: bool, model: str) -> None:
    compiled, dense = pair(invariant, model, 14)
    sensor, space = SENSORS[model], compiled.space
    R = np.eye(space.dim) * 0.01
    z = seen(sensor, dense.x, space.pose) + 1.5
    status, nis = compiled.step(None, None, [(0, z)], R)
    assert status == [kernel.FLAGGED]
    assert nis[0] > chi_square_bound(0.9999, space.dim)
    dense.update(space.pose, z, R)
    assert_equal(compiled, dense)


@both_filters
@pytest.mark.parametrize("model", ["range_bearing", "bearing"])
def test_a_bearing_behind_the_robot_updates_the_short_way(invariant: bool, model: str) -> None:
    x = np.array([0.0, 0.0, 0.0, -5.0, -0.01])
    compiled = Kernel(invariant, replace(SENSORS[model], mount=(0.0, 0.0, 0.0)))
    compiled.set(x, np.eye(5) * 0.01)
    z = np.array([5.0, math.pi - 0.002])[-compiled.channels :]
    status, nis = compiled.step(None, None, [(0, z)], np.eye(compiled.channels) * 0.01)
    assert status == [kernel.USED]
    assert nis[0] < 0.01
