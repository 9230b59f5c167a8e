"""What the estimator's tests share: dense references written from the definitions, and small worlds.

Nothing here uses the package's own filter or solver: Jacobians are numeric, systems are dense.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from submaps.config import MapConfig, MotionConfig, ObservationConfig
from submaps.measurements import Batch

Floats = NDArray[np.float64]
_STENCIL = ((1, 45.0), (2, -9.0), (3, 1.0))  # seventh point weighs nothing: error of order h^6


def jacobian(function: Callable[[Floats], Floats], at: Floats, h: float = 1e-2) -> Floats:
    """(m, n) derivative by seven-point central differences; good to 1e-11 for smooth functions."""
    columns = []
    for i in range(at.shape[0]):
        step = np.zeros_like(at)
        step[i] = h
        columns.append(sum(w * (function(at + k * step) - function(at - k * step)) for k, w in _STENCIL) / (60.0 * h))
    return np.stack(columns, axis=1)


def random_covariance(rng: np.random.Generator, size: int, scale: float = 1.0) -> Floats:
    """A well-conditioned positive definite matrix with every correlation, variances about ``scale``²."""
    A = rng.normal(size=(size, 2 * size + 4))
    whole: Floats = A @ A.T / A.shape[1] * scale**2
    return 0.5 * (whole + whole.T)


# -- SE(2) and the errors of the two filters, from their definitions ---------------------------


def wrapped(angle: float) -> float:
    """The angle in (-pi, pi]."""
    return math.remainder(angle, 2.0 * math.pi)


def R(theta: float) -> Floats:
    """Rotation matrix."""
    return np.array([[math.cos(theta), -math.sin(theta)], [math.sin(theta), math.cos(theta)]])


def V(phi: float) -> Floats:
    """Left Jacobian of the rotation: the integral of R(t phi) over t in [0, 1]."""
    a = math.sin(phi) / phi if phi else 1.0
    b = 2.0 * math.sin(0.5 * phi) ** 2 / phi if phi else 0.0
    return np.array([[a, -b], [b, a]])


def plus(x: Floats, xi: Floats, invariant: bool) -> Floats:
    """The state (p, theta, l_1, ...) moved by an error of the filter."""
    if not invariant:
        return x + xi
    out = np.empty_like(x)
    out[2] = x[2] + xi[2]
    for j in (0, *range(3, x.shape[0], 2)):
        out[j : j + 2] = R(xi[2]) @ x[j : j + 2] + V(xi[2]) @ xi[j : j + 2]
    return out


def minus(x: Floats, base: Floats, invariant: bool) -> Floats:
    """The error that takes ``base`` to ``x``."""
    xi = x - base
    xi[2] = wrapped(xi[2])
    if invariant:
        for j in (0, *range(3, x.shape[0], 2)):
            xi[j : j + 2] = np.linalg.solve(V(xi[2]), x[j : j + 2] - R(xi[2]) @ base[j : j + 2])
    return xi


def after(pose: Floats, increment: Floats) -> Floats:
    """Pose composed with a body-frame increment, the heading not wrapped."""
    return np.array([*(pose[:2] + R(pose[2]) @ increment[:2]), pose[2] + increment[2]])


def relative(a: Floats, b: Floats) -> Floats:
    """T_a_b of two poses."""
    return np.array([*(R(a[2]).T @ (b[:2] - a[:2])), wrapped(b[2] - a[2])])


# -- batches -----------------------------------------------------------------------------------

ODOMETRY = MapConfig(MotionConfig("odometry", (0.02, 0.01, 0.004)), ObservationConfig("cartesian", (0.1, 0.1)))


@dataclass
class Step:
    """One step of a robot: its control and what it saw (name, reading)."""

    control: tuple[float, ...] | None = None
    seen: Sequence[tuple[str, tuple[float, float]]] = ()
    t: float | None = None


def batch(steps: Sequence[Step], start: float = 0.0, dt: float = 0.1) -> Batch:
    """The columns of a few steps."""
    moved = [k for k, s in enumerate(steps) if s.control is not None]
    controls = np.array([steps[k].control for k in moved], dtype=float)
    sightings = [(k, name, z) for k, s in enumerate(steps) for name, z in s.seen]
    return Batch(
        t=np.array([start + dt * k if s.t is None else s.t for k, s in enumerate(steps)]),
        control_step=np.array(moved, dtype=np.int64),
        control=np.ascontiguousarray(controls.T) if moved else np.empty((3, 0)),
        control_covariance=None,
        observation_step=np.array([k for k, _, _ in sightings], dtype=np.int64),
        landmark=tuple(name for _, name, _ in sightings),
        z=np.ascontiguousarray(np.array([z for _, _, z in sightings], dtype=float).reshape(-1, 2).T),
        observation_covariance=None,
    )


def cut(whole: Batch, begin: int, end: int) -> Batch:
    """Steps ``begin`` .. ``end`` - 1 as a batch of their own."""
    c = (whole.control_step >= begin) & (whole.control_step < end)
    o = (whole.observation_step >= begin) & (whole.observation_step < end)
    return Batch(
        t=whole.t[begin:end].copy(),
        control_step=whole.control_step[c] - begin,
        control=np.ascontiguousarray(whole.control[:, c]),
        control_covariance=None if whole.control_covariance is None else whole.control_covariance[c],
        observation_step=whole.observation_step[o] - begin,
        landmark=tuple(name for name, used in zip(whole.landmark, o, strict=True) if used),
        z=np.ascontiguousarray(whole.z[:, o]),
        observation_covariance=None if whole.observation_covariance is None else whole.observation_covariance[o],
    )


def laps(count: int, per_lap: int = 40, laps_: float = 2.0, seed: int = 0, noise: float = 1.0) -> Batch:
    """Odometry round a circle of ``count`` landmarks, each seen within 6 m, for ``ODOMETRY``'s noise."""
    rng = np.random.default_rng(seed)
    angle = 2.0 * np.pi * np.arange(count) / count
    world = np.stack([12.0 * np.sin(angle), 10.0 - 12.0 * np.cos(angle)], axis=1)
    turn = 2.0 * np.pi / per_lap
    increment = np.array([20.0 * math.sin(0.5 * turn) * math.cos(0.5 * turn), 0.0, turn])
    increment[1] = increment[0] * math.tan(0.5 * turn)
    pose = np.zeros(3)
    steps = []
    for k in range(round(laps_ * per_lap) + 1):
        control = None
        if k:
            pose = after(pose, increment)
            control = tuple(increment + noise * rng.normal(size=3) * ODOMETRY.motion.sigma)
        local = (world - pose[:2]) @ R(pose[2])
        near = np.flatnonzero(np.hypot(local[:, 0], local[:, 1]) < 6.0)
        sightings = [(f"p{i}", tuple(local[i] + noise * 0.1 * rng.normal(size=2))) for i in near]
        steps.append(Step(control, sightings))
    return batch(steps)
