"""Laws of the motion models: increments, covariances, and how increments compose."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from submaps.config import MotionConfig
from submaps.errors import ConfigError
from submaps.filtering.closing import flush
from submaps.geometry.space import PLANE
from submaps.motion.increments import dead_reckon, increments
from submaps.motion.limits import followable
from submaps.submap import ActiveSubmap
from tests.core.support import R, Step, after, batch, jacobian, random_covariance

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


L, H = 2.83, 0.76  # m: the car of Victoria Park
VEHICLES = {
    "bicycle": MotionConfig("bicycle", (0.3, 0.05), wheelbase=L),
    "ackermann": MotionConfig("ackermann", (0.3, 0.05, 0.2), wheelbase=L, encoder_offset=H),
    "ackermann, the encoder to the right": MotionConfig("ackermann", (0.3, 0.05), wheelbase=L, encoder_offset=-H),
}


def vehicle(config: MotionConfig, speed: float, steer: float, dt: float) -> tuple[Floats, Floats]:
    """Increment and covariance of one reading of a vehicle."""
    steps, noises = increments(config, batch([Step((speed, steer), t=dt)]), 0.0)
    return steps[0], noises[0]


def lecture(pose: Floats, speed: float, steer: float, dt: float) -> Floats:
    """The pose after one step of the lecture's process model, in its own frame's axes."""
    x, y, psi = pose
    return np.array([
        x + speed * dt * math.cos(psi + steer), y + speed * dt * math.sin(psi + steer),
        psi + speed * dt * math.sin(steer) / L,
    ])  # fmt: skip


def car(config: MotionConfig, speed: float, steer: float, slip: float, dt: float) -> Floats:
    """The pose of a car's rear axle after a reading, from its geometry."""
    v = speed / (1.0 - math.tan(steer) * config.encoder_offset / L)
    return slide(v, slip, v * math.tan(steer) / L, dt)


@pytest.mark.parametrize("speed", [2.0, -0.7, 0.0])
@pytest.mark.parametrize("steer", [0.6, -0.2, 1e-9, 0.0, 2.5])
def test_a_bicycle_follows_the_lecture(speed: float, steer: float) -> None:
    moved, _ = vehicle(VEHICLES["bicycle"], speed, steer, 0.4)
    for pose in (np.zeros(3), np.array([3.0, -2.0, 1.1])):
        assert np.allclose(after(pose, moved), lecture(pose, speed, steer, 0.4), rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("steer", [0.6, -0.6, 1e-4, 1e-9, 0.0])
@pytest.mark.parametrize("name", [name for name in VEHICLES if name != "bicycle"])
def test_a_car_follows_the_arc_of_its_rear_axle(name: str, steer: float) -> None:
    moved, _ = vehicle(VEHICLES[name], 3.0, steer, 0.5)
    assert np.allclose(moved, car(VEHICLES[name], 3.0, steer, 0.0, 0.5), rtol=0.0, atol=2e-15)
    if steer > 0.1:  # turning left, a wheel on the left is slower than the middle of the axle
        assert (np.hypot(*moved[:2]) > 1.5) == (VEHICLES[name].encoder_offset > 0.0)


def test_a_car_without_an_offset_is_a_velocity() -> None:
    config = MotionConfig("ackermann", (0.3, 0.0, 0.2), wheelbase=L)
    for steer in (0.5, 1e-3, 0.0, -1.2):
        moved, noise = vehicle(config, 1.4, steer, 0.6)
        expected, _ = velocity(1.4, 1.4 * math.tan(steer) / L, 0.6)
        assert np.allclose(moved, expected, rtol=0.0, atol=1e-15)
        # The speed alone uncertain: v and omega err together, by 1 : tan(steer) / L.
        at = np.array([0.3, 0.3 * math.tan(steer) / L])
        sent = replace(batch([Step((1.4, 1.4 * math.tan(steer) / L), t=0.6)]),
                       control_covariance=np.outer(at, at)[np.newaxis])  # fmt: skip
        _, theirs = increments(MotionConfig("velocity", (9.0, 9.0, 0.2)), sent, 0.0)
        assert np.allclose(noise, theirs[0], rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("steer", [0.6, -0.3, 1e-5, 0.0])
@pytest.mark.parametrize("speed", [2.0, -0.5, 0.0])
@pytest.mark.parametrize("noise", ["reading", "density"])
@pytest.mark.parametrize("name", VEHICLES)
def test_the_covariance_of_a_vehicle(name: str, noise: Any, speed: float, steer: float) -> None:
    dt, config = 0.7, replace(VEHICLES[name], noise=noise)

    def model(c: Floats) -> Floats:
        return lecture(np.zeros(3), c[0], c[1], dt) if name == "bicycle" else car(config, c[0], c[1], c[2], dt)

    J = jacobian(model, np.array([speed, steer, 0.0]))
    sigma = np.array([*config.sigma, 0.0][:3]) / (1.0 if noise == "reading" else math.sqrt(dt))
    _, found = vehicle(config, speed, steer, dt)
    assert np.allclose(found, J @ np.diag(sigma**2) @ J.T, rtol=1e-9, atol=1e-12)
    assert np.array_equal(found, found.T)


@pytest.mark.parametrize("name", VEHICLES)
def test_a_vehicle_may_bring_its_own_covariance(name: str) -> None:
    own = random_covariance(np.random.default_rng(5), 2, 0.1)
    config = VEHICLES[name]
    sent = replace(batch([Step((2.0, 0.3), t=0.5)]), control_covariance=own[np.newaxis])
    bare = replace(config, sigma=(9.0, 9.0))
    J = jacobian(lambda c: vehicle(config, c[0], c[1], 0.5)[0], np.array([2.0, 0.3]))
    assert np.allclose(increments(bare, sent, 0.0)[1][0], J @ own @ J.T, rtol=1e-9, atol=1e-12)


def test_the_encoder_of_victoria_park_is_on_the_left(data_dir: Path) -> None:
    """Two minutes of its raw controls, rigidly aligned with GPS, whose antenna is at (3.78, 0.50) m."""
    folder = data_dir / "victoria_park_raw"
    if not folder.is_dir():
        pytest.skip(f"no {folder.name} at {data_dir}")
    t_ms, *control = np.loadtxt(folder / "controls.csv", delimiter=",", skiprows=1, max_rows=4800).T
    fixes = np.loadtxt(folder / "gps.csv", delimiter=",", skiprows=1)
    fixes = fixes[(fixes[:, 0] > t_ms[0]) & (fixes[:, 0] < t_ms[-1])]
    sent = batch([Step((v, steer), t=t) for t, v, steer in zip(t_ms / 1e3, *control, strict=True)])
    assert followable(VEHICLES["ackermann"], sent.control).all()
    errors = []
    for offset in (H, 0.0, -H):
        steps, noises = increments(replace(VEHICLES["ackermann"], encoder_offset=offset), sent, None)
        track = np.empty((sent.steps, 3))
        dead_reckon(PLANE.key, np.zeros(3), np.zeros((3, 3)), steps, noises, sent.control_step, track)
        antenna = np.stack([after(pose, np.array([3.78, 0.5, 0.0]))[:2] for pose in track])
        there = np.stack([np.interp(fixes[:, 0], t_ms, column) for column in antenna.T], axis=1)
        a, b = there - there.mean(axis=0), fixes[:, 1:] - fixes[:, 1:].mean(axis=0)
        turn = np.angle(np.sum((b[:, 0] + 1j * b[:, 1]) * (a[:, 0] - 1j * a[:, 1])))
        errors.append(float(np.median(np.hypot(*(a @ R(turn).T - b).T))))
    assert errors[0] < 2.5
    assert errors[0] < 0.5 * errors[1] < 0.5 * errors[2]


CONTROLS: dict[str, tuple[MotionConfig, tuple[float, ...]]] = {
    "odometry": (MotionConfig("odometry", (0.1, 0.2, 0.05)), (0.4, -0.1, 0.06)),
    "velocity": (MotionConfig("velocity", (0.1, 0.05, 0.2)), (0.4, 0.06)),
    **{name: (config, (0.4, 0.1)) for name, config in VEHICLES.items()},
}


@pytest.mark.parametrize("name", CONTROLS)
def test_an_interval_split_in_parts_has_the_same_covariance_under_density(name: str) -> None:
    """To first order in the increment; the sigma of a reading would shrink by the number of parts."""
    config, control = CONTROLS[name]
    ratio: dict[str, list[float]] = {"density": [], "reading": []}
    for scale in (1.0, 1e-3):
        for noise, ratios in ratio.items():
            model = replace(config, noise=noise)  # type: ignore[arg-type]
            found = [split(model, tuple(scale * c for c in control), parts) for parts in (1, 10)]
            ratios.append(float(np.trace(found[1]) / np.trace(found[0])))
            if noise == "density":
                assert np.allclose(found[0], found[1], rtol=0.0, atol=0.4 * scale * np.abs(found[0]).max())
    assert ratio["density"][1] == pytest.approx(1.0, abs=1e-3)
    assert ratio["reading"][1] == pytest.approx(10.0 if name == "odometry" else 0.1, rel=1e-2)


def split(config: MotionConfig, control: tuple[float, ...], parts: int) -> Floats:
    """Covariance of dead reckoning over one second, cut into equal parts."""
    each = tuple(c / parts for c in control) if config.model == "odometry" else control
    sent = batch([Step(each, t=(k + 1) / parts) for k in range(parts)])
    steps, noises = increments(config, sent, 0.0)
    pose, covariance = np.zeros(3), np.zeros((3, 3))
    dead_reckon(PLANE.key, pose, covariance, steps, noises, sent.control_step, np.empty((parts, 3)))
    return covariance


@pytest.mark.parametrize("name", CONTROLS)
def test_no_time_no_noise_under_density(name: str) -> None:
    config, control = CONTROLS[name]
    config = replace(config, noise="density")
    assert np.array_equal(increments(config, batch([Step(control, t=3.0)]), None)[1][0], np.zeros((3, 3)))
    for dt in (5e-324, 1e-300, 1e-12):
        _, noises = increments(config, batch([Step(control, t=dt)]), 0.0)
        assert np.isfinite(noises).all()


def test_a_reading_without_a_covariance_of_its_own_has_that_of_the_density() -> None:
    config = MotionConfig("odometry", (0.1, 0.2, 0.3), "density")
    own = np.full((3, 3, 3), np.nan)
    own[1] = random_covariance(np.random.default_rng(6), 3, 0.1)
    sent = replace(batch([Step((1.0, 0.0, 0.0), t=t) for t in (1.0, 1.5, 4.0)]), control_covariance=own)
    _, noises = increments(config, sent, 0.8)
    for k, dt in ((0, 0.2), (2, 2.5)):
        assert np.allclose(noises[k], np.diag([0.01, 0.04, 0.09]) * dt, rtol=1e-12)
    assert np.array_equal(noises[1], own[1])


@pytest.mark.parametrize(("field", "arguments"), [
    ("motion.model", ("tracks", (0.1, 0.1))),
    ("motion.noise", ("velocity", (0.1, 0.1), "per step")),
    ("motion.sigma", ("bicycle", (0.1, 0.1, 0.1), "reading", 2.0)),
    ("motion.sigma", ("ackermann", (0.1,), "reading", 2.0)),
    ("motion.wheelbase", ("bicycle", (0.1, 0.1))),
    ("motion.wheelbase", ("ackermann", (0.1, 0.1), "reading", 0.0)),
    ("motion.wheelbase", ("ackermann", (0.1, 0.1), "reading", math.inf)),
    ("motion.wheelbase", ("velocity", (0.1, 0.1), "reading", 2.0)),
    ("motion.encoder_offset", ("ackermann", (0.1, 0.1), "reading", 2.0, 2.0)),
    ("motion.encoder_offset", ("ackermann", (0.1, 0.1), "reading", 2.0, math.nan)),
    ("motion.encoder_offset", ("bicycle", (0.1, 0.1), "reading", 2.0, 0.5)),
    ("motion.encoder_offset", ("odometry", (0.1, 0.1, 0.1), "reading", None, 0.5)),
])  # fmt: skip
def test_a_motion_that_cannot_be_is_refused(field: str, arguments: tuple[Any, ...]) -> None:
    with pytest.raises(ConfigError) as refused:
        MotionConfig(*arguments)
    assert refused.value.field == field


def test_what_a_vehicle_can_follow() -> None:
    steer = np.array([0.0, 1.4, -1.4, 1.49, -1.49, 1.51, -1.51, 3.2])
    control = np.stack([np.ones_like(steer), steer])
    expected = {
        "bicycle": [True] * 7 + [False],
        "ackermann": [True, False, True, False, True, False, False, False],  # the inner wheel stops at 1.3 rad
        "ackermann, the encoder to the right": [True, True, False, True, False, False, False, False],
    }
    for name, config in VEHICLES.items():
        assert followable(config, control).tolist() == expected[name]
        followed = [vehicle(config, 1.0, float(a), 1.0) for a in steer[followable(config, control)]]
        assert all(np.isfinite(moved).all() and np.isfinite(noise).all() for moved, noise in followed)
    assert followable(MotionConfig("velocity", (0.1, 0.1)), control).all()


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
    dead_reckon(PLANE.key, pose, covariance, steps, noises, at, track)
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
    pending, noise = once.motion[2:5], once.motion[5:].reshape(3, 3)
    dead_reckon(PLANE.key, pending, noise, steps, noises, np.arange(20), np.empty((20, 3)))
    flush(once.space.key, once.x, once.P, once.counts, once.motion, int(invariant), once.scratch)
    for step, own in zip(steps, noises, strict=True):
        each.motion[2:5], each.motion[5:] = step, own.ravel()
        flush(each.space.key, each.x, each.P, each.counts, each.motion, int(invariant), each.scratch)
    n = once.dimension
    assert np.allclose(once.x[:n], each.x[:n], rtol=0.0, atol=1e-12)
    scale = np.sqrt(np.outer(np.diag(each.P[:n, :n]), np.diag(each.P[:n, :n])))
    assert np.max(np.abs(once.P[:n, :n] - each.P[:n, :n]) / scale) < 1e-12
