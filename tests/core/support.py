"""What the estimator's tests share: dense references written from the definitions, and small worlds.

Nothing here uses the package's own filter or solver: Jacobians are numeric, systems are dense.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from submaps.atlas.state import AtlasState, RobotState
from submaps.config import MapConfig, MotionConfig, ObservationConfig
from submaps.measurements import Batch
from submaps.submap import Submap

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


# -- atlases made by hand ----------------------------------------------------------------------


def pack(P: Floats) -> Floats:
    """Lower triangle, row by row."""
    return np.ascontiguousarray(P[np.tril_indices(P.shape[0])])


def submap(
    number: int, landmarks: Sequence[int], mean: Floats, P: Floats, *, following: int = -1, previous: int | None = None,
    robot: int = 0, invariant: bool = True,
) -> Submap:  # fmt: skip
    """A sub-map that says what it is told to; ``following`` -1 makes it an active one."""
    return Submap(
        number=number, robot=robot, previous=number - 1 if previous is None else previous, following=following,
        began=float(number), ended=number + 1.0, steps=1, observed_steps=1, observations=len(landmarks), rejected=0,
        nis_sum=0.0, nis_count=0, invariant=invariant, landmarks=np.array(landmarks, dtype=np.int32),
        mean=np.asarray(mean, dtype=float), packed=pack(P),
    )  # fmt: skip


def atlas(submaps: Sequence[Submap], config: MapConfig = ODOMETRY) -> AtlasState:
    """The state that holds these sub-maps; landmark i is named ``Li``."""
    count = 1 + max((int(s.landmarks.max(initial=-1)) for s in submaps), default=-1)
    names = [f"L{i}" for i in range(count)]
    active = {s.number: s for s in submaps if s.active}
    robots = {}
    for s in active.values():
        first = min(other.number for other in submaps if other.robot == s.robot)
        robots[f"r{s.robot}"] = RobotState(
            f"r{s.robot}", s.robot, first, s.number, s.ended, 1, 1, 0, s.pose, (0.0, 0.0, 0.0), np.zeros((3, 3))
        )
    return AtlasState(
        config=replace(config, filter="invariant" if submaps[0].invariant else "standard"),
        records=[None if s.active else s for s in submaps], submap_count=len(submaps), active=active, names=names,
        landmark_count=count, number_of={name: i for i, name in enumerate(names)},
        sightings=[[s.number for s in submaps if not s.active and s.holds(i)] for i in range(count)],
        robots=robots, closed_bytes=0, version=0,
    )  # fmt: skip


def chain(
    holds: Sequence[Sequence[int]],
    *,
    sigma: float = 0.05,
    seed: int = 0,
    invariant: bool = True,
    closed: int | None = None,
) -> list[Submap]:
    """A drive through a random world: noisy sub-maps that hold the named landmarks, the last active.

    Errors are drawn from the covariances, of ``sigma`` metres and a fifth of it in radians.
    """
    rng = np.random.default_rng(seed)
    count = 1 + max(max(h, default=0) for h in holds)
    frames = [np.zeros(3)]
    for _ in holds:
        frames.append(after(frames[-1], np.array([4.0, rng.normal(), rng.normal() * 0.5])))
    world = rng.uniform(-6.0, 6.0, size=(count, 2)) + np.linspace([0.0, 0.0], frames[-1][:2], count)
    out = []
    for k, held in enumerate(holds):
        local = [(world[i] - frames[k][:2]) @ R(frames[k][2]) for i in held]
        truth = np.concatenate([relative(frames[k], frames[k + 1]), *local])
        P = random_covariance(rng, truth.shape[0], sigma)
        P[2] *= 0.2
        P[:, 2] *= 0.2
        error = np.linalg.cholesky(P) @ rng.normal(size=truth.shape[0])
        mean = plus(truth, error, invariant)
        is_last = k == len(holds) - 1
        out.append(submap(k, held, mean, P, following=-1 if is_last else k + 1, invariant=invariant))
    return out


@dataclass
class Dense:
    """The joined problem solved with every landmark kept: values and covariance of all variables."""

    frames: Floats  # (n + 1, 3), the last is the end of the last sub-map
    landmarks: Floats  # (m, 2)
    covariance: Floats
    numbers: list[int]
    cost: float

    def pose_at(self, k: int) -> list[int]:
        """Entries of frame k (k >= 1) in the covariance."""
        return [3 * (k - 1) + a for a in range(3)]

    def landmark_at(self, number: int) -> list[int]:
        """Entries of a landmark in the covariance."""
        first = 3 * (self.frames.shape[0] - 1) + 2 * self.numbers.index(number)
        return [first, first + 1]

    def joint(self, k: int, shared: Sequence[int]) -> Floats:
        """Covariance of frame k, frame k + 1 and landmarks; zero where the frame is fixed."""
        size = 6 + 2 * len(shared)
        out = np.zeros((size, size))
        at = (self.pose_at(k) if k else []) + self.pose_at(k + 1) + [e for i in shared for e in self.landmark_at(i)]
        free = size - len(at)
        out[free:, free:] = self.covariance[np.ix_(at, at)]
        return out


def dense_join(submaps: Sequence[Submap]) -> Dense:
    """argmin of sum xi^T P^-1 xi over every frame and every landmark, dense, by numeric Jacobians."""
    n = len(submaps)
    numbers = sorted({int(i) for s in submaps for i in s.landmarks})
    place = {number: 3 * n + 2 * i for i, number in enumerate(numbers)}
    values = np.zeros(3 * n + 2 * len(numbers))
    values[3 * n :] = np.nan
    pose = np.zeros(3)
    roots, entries = [], []
    for k, s in enumerate(submaps):
        for i, slot in s.slots().items():
            if np.isnan(values[place[i]]):
                values[place[i] : place[i] + 2] = pose[:2] + R(pose[2]) @ s.mean[slot : slot + 2]
        pose = after(pose, s.mean[:3])
        values[3 * k : 3 * k + 3] = pose
        roots.append(np.linalg.inv(np.linalg.cholesky(s.covariance())))
        frame = [3 * k - 3, 3 * k - 2, 3 * k - 1] if k else []
        own = [place[int(i)] + a for i in s.landmarks for a in (0, 1)]
        entries.append(np.array(frame + [3 * k, 3 * k + 1, 3 * k + 2] + own))

    def residual(k: int, v: Floats) -> Floats:
        frame, rest = (v[:3], v[3:]) if k else (np.zeros(3), v)
        points = (rest[3:].reshape(-1, 2) - frame[:2]) @ R(frame[2])
        local = np.concatenate([relative(frame, rest[:3]), points.ravel()])
        return np.asarray(roots[k] @ minus(local, submaps[k].mean, submaps[k].invariant))

    for _ in range(30):
        H, g, cost = np.zeros((values.shape[0],) * 2), np.zeros(values.shape[0]), 0.0
        for k, at in enumerate(entries):
            r, J = residual(k, values[at]), jacobian(lambda v, k=k: residual(k, v), values[at], 1e-3)  # type: ignore[misc]
            H[np.ix_(at, at)] += J.T @ J
            g[at] += J.T @ r
            cost += float(r @ r)
        step = np.linalg.solve(H, g)
        values = values - step
        if np.abs(step).max() < 1e-11:
            break
    frames = np.vstack([np.zeros(3), values[: 3 * n].reshape(-1, 3)])
    covariance = np.asarray(np.linalg.inv(H), dtype=np.float64)
    return Dense(frames, values[3 * n :].reshape(-1, 2), covariance, numbers, cost)
