"""Atlases made by hand, in the plane and in space, and the joined problem solved densely from the definitions.

Nothing here uses the package's own solver: Jacobians are numeric, systems are dense.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from submaps.atlas.state import AtlasState, RobotState
from submaps.config import MapConfig, MotionConfig, ObservationConfig
from submaps.geometry.space import PLANE, SOLID, Space
from submaps.submap import Submap
from tests.core.filters import after, minus, plus, rotation, turned
from tests.core.support import ODOMETRY, random_covariance, wrapped

Floats = NDArray[np.float64]

both_filters = pytest.mark.parametrize("invariant", [True, False], ids=["invariant", "standard"])
both_spaces = pytest.mark.parametrize("space", [PLANE, SOLID], ids=["plane", "space"])
IN_SPACE = MapConfig(
    MotionConfig("odometry3d", (0.02, 0.01, 0.01, 0.004, 0.004, 0.004)),
    ObservationConfig("cartesian3d", (0.1, 0.1, 0.1)),
    space="se3",
)
CONFIGS = {PLANE: ODOMETRY, SOLID: IN_SPACE}


def relative(space: Space, a: Floats, b: Floats) -> Floats:
    """T_a_b of two poses."""
    d = space.dim
    position = rotation(space, a[d:]).T @ (b[:d] - a[:d])
    angles = turned(space, -a[d:], b[d:])
    return np.concatenate([position, [wrapped(float(angles[0]))] if d == 2 else angles])


def inside(space: Space, frame: Floats, points: Floats) -> Floats:
    """Points (n, dim) given beside a frame, in it."""
    return np.asarray((points - frame[: space.dim]) @ rotation(space, frame[space.dim :]))


def outside(space: Space, frame: Floats, points: Floats) -> Floats:
    """Points (n, dim) given in a frame, beside it."""
    return np.asarray(points @ rotation(space, frame[space.dim :]).T + frame[: space.dim])


def moved(space: Space, pose: Floats, e: Floats) -> Floats:
    """The pose with an increment: p + e_p, exp(e_theta) R."""
    return np.concatenate([pose[: space.dim] + e[: space.dim], turned(space, e[space.dim :], pose[space.dim :])])


def slopes(function: Callable[[Floats], Floats], size: int, h: float = 1e-3) -> Floats:
    """(m, size) derivative at zero by five-point central differences; the error is of order h^4."""
    columns = []
    for unit in h * np.eye(size):
        near, far = function(unit) - function(-unit), function(2.0 * unit) - function(-2.0 * unit)
        columns.append((8.0 * near - far) / (12.0 * h))
    return np.stack(columns, axis=1)


def additive(s: Submap) -> Floats:
    """Covariance of a sub-map's additive errors, by numeric Jacobian from its definition."""
    space = s.space
    J = slopes(lambda xi: minus(space, plus(space, s.mean, xi, s.invariant), s.mean, False), s.mean.shape[0])
    whole: Floats = J @ s.covariance() @ J.T
    return whole


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


def atlas(submaps: Sequence[Submap], config: MapConfig | None = None) -> AtlasState:
    """The state that holds these sub-maps; landmark i is named ``Li``."""
    space = submaps[0].space
    count = 1 + max((int(s.landmarks.max(initial=-1)) for s in submaps), default=-1)
    names = [f"L{i}" for i in range(count)]
    active = {s.number: s for s in submaps if s.active}
    robots = {}
    for s in active.values():
        first = min(other.number for other in submaps if other.robot == s.robot)
        robots[f"r{s.robot}"] = RobotState(
            f"r{s.robot}", s.robot, first, s.number, s.ended, 1, 1, 0, s.pose, space.origin,
            np.zeros((space.pose, space.pose)),
        )  # fmt: skip
    return AtlasState(
        config=replace(config or CONFIGS[space], filter="invariant" if submaps[0].invariant else "standard"),
        records=[None if s.active else s for s in submaps], submap_count=len(submaps), active=active, names=names,
        landmark_count=count, number_of={name: i for i, name in enumerate(names)},
        sightings=[[s.number for s in submaps if not s.active and s.holds(i)] for i in range(count)],
        robots=robots, closed_bytes=0, version=0,
    )  # fmt: skip


def drive(space: Space, rng: np.random.Generator, steps: int, landmarks: int) -> tuple[list[Floats], Floats]:
    """True frames along a drive of 4 m a step, and landmarks (n, dim) beside it."""
    d, frames = space.dim, [np.zeros(space.pose)]
    for _ in range(steps):
        increment = np.concatenate([[4.0], rng.normal(size=d - 1), rng.normal(size=space.rot) * 0.5])
        frames.append(after(space, frames[-1], increment))
    along = np.linspace(np.zeros(d), frames[-1][:d], landmarks)
    return frames, rng.uniform(-6.0, 6.0, size=(landmarks, d)) + along


def chain(
    holds: Sequence[Sequence[int]],
    space: Space = PLANE,
    *,
    sigma: float = 0.05,
    seed: int = 0,
    invariant: bool = True,
) -> list[Submap]:
    """A drive through a random world: noisy sub-maps that hold the named landmarks, the last active.

    Errors are drawn from the covariances, of ``sigma`` metres and a fifth of it in radians.
    """
    rng = np.random.default_rng(seed)
    frames, world = drive(space, rng, len(holds), 1 + max(max(h, default=0) for h in holds))
    out, angles = [], slice(space.dim, space.pose)
    for k, held in enumerate(holds):
        local = inside(space, frames[k], world[list(held)].reshape(-1, space.dim))
        truth = np.concatenate([relative(space, frames[k], frames[k + 1]), local.ravel()])
        P = random_covariance(rng, truth.shape[0], sigma)
        P[angles] *= 0.2
        P[:, angles] *= 0.2
        error = np.linalg.cholesky(P) @ rng.normal(size=truth.shape[0])
        mean = plus(space, truth, error, invariant)
        is_last = k == len(holds) - 1
        out.append(submap(k, held, mean, P, following=-1 if is_last else k + 1, invariant=invariant))
    return out


def forgotten(s: Submap, position: float = 1e3, rotation_: float = 10.0) -> Submap:
    """The sub-map as it closes where no motion is measured: of its end it says next to nothing.

    In additive errors, for in those the landmarks have nothing to do with the end.
    """
    p, P = s.space.pose, additive(s)
    P[:p], P[:, :p] = 0.0, 0.0
    P[range(p), range(p)] = [position**2] * s.space.dim + [rotation_**2] * s.space.rot
    return replace(s, packed=pack(0.5 * (P + P.T)), invariant=False)


@dataclass
class Dense:
    """The joined problem solved with every landmark kept: values and covariance of all variables."""

    space: Space
    frames: Floats  # (n + 1, pose), the last is the end of the last sub-map
    landmarks: Floats  # (m, dim)
    covariance: Floats
    numbers: list[int]
    cost: float

    def pose_at(self, k: int) -> list[int]:
        """Entries of frame k (k >= 1) in the covariance."""
        return [self.space.pose * (k - 1) + a for a in range(self.space.pose)]

    def landmark_at(self, number: int) -> list[int]:
        """Entries of a landmark in the covariance."""
        first = self.space.pose * (self.frames.shape[0] - 1) + self.space.dim * self.numbers.index(number)
        return [first + a for a in range(self.space.dim)]

    def landmark(self, number: int) -> Floats:
        """Where a landmark lies."""
        return np.asarray(self.landmarks[self.numbers.index(number)])

    def joint(self, k: int, shared: Sequence[int]) -> Floats:
        """Covariance of frame k, frame k + 1 and landmarks; zero where the frame is fixed."""
        size = 2 * self.space.pose + self.space.dim * len(shared)
        out = np.zeros((size, size))
        at = (self.pose_at(k) if k else []) + self.pose_at(k + 1) + [e for i in shared for e in self.landmark_at(i)]
        free = size - len(at)
        out[free:, free:] = self.covariance[np.ix_(at, at)]
        return out


def dense_join(submaps: Sequence[Submap]) -> Dense:
    """argmin of sum xi^T P^-1 xi over every frame and every landmark, dense, by numeric Jacobians."""
    n, space = len(submaps), submaps[0].space
    d, p = space.dim, space.pose
    numbers = sorted({int(i) for s in submaps for i in s.landmarks})
    place = {number: p * n + d * i for i, number in enumerate(numbers)}
    frames, points = [np.zeros(p)], np.full((len(numbers), d), np.nan)
    roots, entries = [], []
    for k, s in enumerate(submaps):
        for i, slot in s.slots().items():
            row = numbers.index(i)
            if np.isnan(points[row, 0]):
                points[row] = outside(space, frames[k], s.mean[slot : slot + d])
        frames.append(after(space, frames[k], s.mean[:p]))
        roots.append(np.linalg.inv(np.linalg.cholesky(s.covariance())))
        own = [place[int(i)] + a for i in s.landmarks for a in range(d)]
        entries.append(np.array([p * (k - 1) + a for a in range(0 if k else p, 2 * p)] + own))

    def residual(k: int, e: Floats) -> Floats:
        frame = moved(space, frames[k], e[:p]) if k else frames[0]
        rest = e[p:] if k else e
        held = [numbers.index(int(i)) for i in submaps[k].landmarks]
        local = inside(space, frame, points[held].reshape(-1, d) + rest[p:].reshape(-1, d))
        predicted = np.concatenate([relative(space, frame, moved(space, frames[k + 1], rest[:p])), local.ravel()])
        return np.asarray(roots[k] @ minus(space, predicted, submaps[k].mean, submaps[k].invariant))

    size = p * n + d * len(numbers)
    for _ in range(30):
        H, g, cost = np.zeros((size, size)), np.zeros(size), 0.0
        for k, at in enumerate(entries):
            r, J = residual(k, np.zeros(len(at))), slopes(lambda e, k=k: residual(k, e), len(at))  # type: ignore[misc]
            H[np.ix_(at, at)] += J.T @ J
            g[at] += J.T @ r
            cost += float(r @ r)
        step = np.asarray(-np.linalg.solve(H, g), dtype=np.float64)
        frames[1:] = [moved(space, f, step[p * k : p * (k + 1)]) for k, f in enumerate(frames[1:])]
        points += step[p * n :].reshape(-1, d)
        if np.abs(step).max() < 1e-11:
            break
    return Dense(space, np.array(frames), points, np.asarray(np.linalg.inv(H)), numbers, cost)


def apart(space: Space, a: Floats, b: Floats) -> Floats:
    """How far poses (n, pose) lie from others: e with a = moved(b, e)."""
    return np.array([minus(space, x, y, False) for x, y in zip(np.atleast_2d(a), np.atleast_2d(b), strict=True)])
