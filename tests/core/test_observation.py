"""Laws of the observation models."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from submaps.config import ObservationConfig
from submaps.observation.models import MODELS, reading, sensor_of, shown
from tests.core import filters
from tests.core.filters import SENSORS, difference, seen, space_of, with_prior
from tests.core.support import jacobian

Floats = NDArray[np.float64]
every = pytest.mark.parametrize("name", sorted(SENSORS))
PLANAR = [np.array(p) for p in ((10.0, 4.0), (-7.0, 2.0), (3.0, -9.0), (-8.0, -8.0), (120.0, 0.0))]
# In front of the camera, whose mount looks about along the body's x axis.
SOLID = [np.array(p) for p in ((10.0, 4.0, 1.0), (7.0, -2.0, 3.0), (23.0, 9.0, -6.0), (120.0, 0.0, 2.0))]


def points(name: str) -> list[Floats]:
    return PLANAR if space_of(SENSORS[name]).dim == 2 else SOLID


def at(sensor: ObservationConfig, y: Floats) -> tuple[Floats, int]:
    """A state with the robot at the origin and the landmark at y, and the landmark's place."""
    pose = space_of(sensor).pose
    return np.concatenate([np.zeros(pose), y]), pose


def ours(sensor: ObservationConfig, y: Floats) -> tuple[Floats, Floats]:
    space = space_of(sensor)
    return reading(space.key, MODELS[sensor.model], sensor_of(space, sensor), y)


def test_every_model_has_its_row() -> None:
    assert {SENSORS[name].model for name in SENSORS} == set(MODELS)


@every
def test_the_reading_is_what_the_sensor_would_see(name: str) -> None:
    sensor = SENSORS[name]
    for y in points(name):
        h, _ = ours(sensor, y)
        assert np.allclose(difference(sensor, h, seen(sensor, *at(sensor, y))), 0.0, atol=1e-11)


@every
def test_derivatives_agree_with_central_differences(name: str) -> None:
    sensor = SENSORS[name]
    for y in points(name):
        h, H = ours(sensor, y)

        def change(v: Floats, h: Floats = h) -> Floats:
            return difference(sensor, ours(sensor, v)[0], h)

        numeric = jacobian(change, y)
        assert np.abs(H - numeric).max() <= 1e-6 * np.abs(H).max()


@every
def test_a_measurement_inverted_is_the_point_with_its_noise_carried_over(name: str) -> None:
    sensor, rng = SENSORS[name], np.random.default_rng(1)
    space, c = space_of(sensor), len(sensor.channels)
    root = rng.normal(size=(c, c)) * 0.05
    R = root @ root.T + 1e-4 * np.eye(c)
    for y in points(name):
        state, slot = at(sensor, y)
        z, noise = with_prior(sensor, seen(sensor, state, slot), R)
        point, W = shown(space.key, MODELS[sensor.model], sensor_of(space, sensor), z[:c].copy(), R)
        if sensor.depth is None:
            assert np.allclose(point, y, rtol=1e-12, atol=1e-11)
        assert np.allclose(point, filters.shown(sensor, state, z), rtol=1e-12)

        def point_of(v: Floats, state: Floats = state) -> Floats:
            return filters.shown(sensor, state, v)

        J = jacobian(point_of, z, 1e-3)
        assert np.allclose(W, J @ noise @ J.T, rtol=1e-7, atol=1e-12)


def test_a_bearing_to_the_sensor_itself_is_not_finite() -> None:
    for name in ("range_bearing", "bearing"):
        sensor = SENSORS[name]
        h, H = ours(sensor, np.array(sensor.mount[:2]))
        assert not np.isfinite(np.append(H.ravel(), h)).all()


@pytest.mark.parametrize("name", ["stereo", "pinhole"])
def test_what_lies_behind_a_camera_has_no_reading(name: str) -> None:
    h, _ = ours(SENSORS[name], np.array([-5.0, 0.0, 0.0]))
    assert not np.isfinite(h).any()


def test_a_pair_of_pixels_without_disparity_shows_no_point() -> None:
    sensor, space = SENSORS["stereo"], space_of(SENSORS["stereo"])
    for right in (300.0, 301.0):
        z = np.array([300.0, 200.0, right, 200.0])
        point, _ = shown(space.key, MODELS["stereo"], sensor_of(space, sensor), z, np.eye(4))
        assert not any(math.isfinite(v) for v in point)
