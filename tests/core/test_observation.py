"""Laws of the observation models."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from submaps.observation.models import CARTESIAN, MODELS, RANGE_BEARING, innovation, invert, predict
from tests.core.support import jacobian, seen, shown

Floats = NDArray[np.float64]
MOUNTS = [(0.0, 0.0, 0.0), (0.7, -0.3, 0.4), (-1.2, 0.5, math.pi), (3.6, 0.5, -2.0)]
NAMES = {number: name for name, number in MODELS.items()}
POINTS = [np.array(p) for p in ((10.0, 4.0), (-7.0, 2.0), (3.0, -9.0), (-8.0, -8.0), (120.0, 0.0))]

cases = pytest.mark.parametrize("model", sorted(NAMES))
mounts = pytest.mark.parametrize("mount", MOUNTS)


def raw(mount: tuple[float, float, float]) -> Floats:
    """A mount as the kernel takes it."""
    return np.array([mount[0], mount[1], math.cos(mount[2]), math.sin(mount[2])])


@cases
@mounts
def test_the_reading_is_what_the_sensor_would_see(model: int, mount: tuple[float, float, float]) -> None:
    for y in POINTS:
        expected = seen(NAMES[model], mount, np.array([0.0, 0.0, 0.0, *y]), 3)
        h = predict(model, float(y[0]), float(y[1]), raw(mount))[:2]
        difference = innovation(model, float(expected[0]), float(expected[1]), *h)
        assert difference == pytest.approx((0.0, 0.0), abs=1e-12)
        back = invert(model, float(expected[0]), float(expected[1]), raw(mount))[:2]
        assert back == pytest.approx(tuple(shown(NAMES[model], mount, np.zeros(3), expected)), abs=1e-12)


@cases
@mounts
def test_inversion_undoes_prediction(model: int, mount: tuple[float, float, float]) -> None:
    for y in POINTS:
        h = predict(model, float(y[0]), float(y[1]), raw(mount))
        back = invert(model, h[0], h[1], raw(mount))
        assert back[:2] == pytest.approx(tuple(y), rel=1e-13, abs=1e-12)
        forth = np.array(h[2:]).reshape(2, 2) @ np.array(back[2:]).reshape(2, 2)
        assert np.allclose(forth, np.eye(2), atol=1e-12)


@cases
@mounts
def test_derivatives(model: int, mount: tuple[float, float, float]) -> None:
    m = raw(mount)
    for y in POINTS:
        at = predict(model, float(y[0]), float(y[1]), m)

        def h(v: Floats, at: tuple[float, ...] = at) -> Floats:
            z = predict(model, float(v[0]), float(v[1]), m)
            return np.array(innovation(model, z[0], z[1], at[0], at[1]))

        def y_of(z: Floats) -> Floats:
            return np.array(invert(model, float(z[0]), float(z[1]), m)[:2])

        assert np.allclose(np.array(at[2:]).reshape(2, 2), jacobian(h, y), rtol=1e-8, atol=1e-10)
        inverse = invert(model, at[0], at[1], m)
        assert np.allclose(np.array(inverse[2:]).reshape(2, 2), jacobian(y_of, np.array(at[:2])), rtol=1e-8, atol=1e-9)


def test_a_bearing_difference_goes_the_short_way() -> None:
    assert innovation(RANGE_BEARING, 5.0, 3.1, 4.0, -3.1) == pytest.approx((1.0, 6.2 - 2.0 * math.pi))
    assert innovation(CARTESIAN, 5.0, 3.1, 4.0, -3.1) == pytest.approx((1.0, 6.2))


def test_a_bearing_to_the_sensor_itself_is_not_finite() -> None:
    at_sensor = predict(RANGE_BEARING, 0.7, -0.3, raw(MOUNTS[1]))
    assert not all(math.isfinite(v) for v in at_sensor)
