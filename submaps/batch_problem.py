"""The batch problem of one robot as arrays: its poses, its readings, and their rows of the normal equations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from submaps import residuals, space_residuals
from submaps.alignment import align
from submaps.config import MotionConfig, ObservationConfig
from submaps.geometry.space import SPACES, Space
from submaps.least_squares import Linearised
from submaps.measurements import Batch
from submaps.motion.increments import increments
from submaps.residuals import information_root

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_LEAST_KNOWN = 3  # readings of known landmarks that put a pose without motion


class Equations(Protocol):
    """What the plane (``residuals``) and space (``space_residuals``) each have their own of."""

    def moved(self, before: Floats, after: Floats, increment: Floats, root: Floats) -> tuple[Floats, Floats]: ...

    def seen(
        self, pose: Floats, point: Floats, observation: ObservationConfig, z: Floats, root: Floats
    ) -> tuple[Floats, Floats]: ...

    def to_body(self, observation: ObservationConfig, z: Floats) -> Floats: ...

    def composed(self, pose: Floats, increment: Floats) -> Floats: ...

    def to_map(self, pose: Floats, body: Floats) -> Floats: ...

    def moved_back(self, poses: Floats, errors: Floats) -> Floats: ...


_EQUATIONS: dict[str, Equations] = {"se2": residuals, "se3": space_residuals}


@dataclass
class State:
    """Poses (n, pose) and landmarks (k, dim)."""

    poses: Floats
    landmarks: Floats


@dataclass(frozen=True)
class Readings:
    """What one sensor said: reading i was made from pose ``pose[i]`` (not falling) of landmark ``landmark[i]``."""

    sensor: ObservationConfig
    pose: Ints  # (m,)
    landmark: Ints  # (m,)
    z: Floats  # (m, channels)
    root: Floats  # (m, channels, channels), W with Wᵀ W the information

    def __len__(self) -> int:
        return len(self.pose)

    def before(self, stop: int) -> int:
        """Number of readings made from the poses before ``stop``."""
        return int(np.searchsorted(self.pose, stop))

    def rows(self, equations: Equations, state: State, stop: int) -> tuple[Floats, Floats]:
        """Of those, residuals (m, channels) and derivatives (m, channels, pose + dim) by pose and landmark."""
        own = slice(self.before(stop))
        pose, point = state.poses[self.pose[own]], state.landmarks[self.landmark[own]]
        return equations.seen(pose, point, self.sensor, self.z[own], self.root[own])

    def columns(self, space: Space, stop: int) -> Ints:
        """The unknowns (m, pose + dim) that their rows are about, the landmarks after the poses before ``stop``."""
        own = slice(self.before(stop))
        pose = space.pose * self.pose[own, None] + np.arange(space.pose)
        return np.hstack([pose, space.pose * stop + space.dim * self.landmark[own, None] + np.arange(space.dim)])


@dataclass(frozen=True)
class Problem:
    """The measurements: pose 0 is the origin, and each control leads to one pose more.

    Without motion each step that can be put has a pose of its own, and there are no increments. ``depths`` are the
    priors on the depth of landmarks, where a reading leaves it open, at their first readings.
    """

    space: Space
    poses: int
    increment: Floats  # (c, pose)
    increment_root: Floats  # (c, pose, pose)
    readings: Readings
    depths: Readings
    body: Floats  # (m, dim) where in the body's frame each reading shows it
    known: Ints  # (m,) landmarks known after each reading
    ids: tuple[str, ...]
    pose_of_step: Ints  # (n,), -1 where there is none

    @staticmethod
    def of(batch: Batch, motion: MotionConfig, observation: ObservationConfig) -> Problem:
        """The problem of a whole run."""
        space, z = SPACES[motion.space], np.ascontiguousarray(batch.z.T)
        body = _EQUATIONS[space.name].to_body(observation, z)
        rows = _placeable(batch, z, body)
        if motion.model == "none":
            rows, pose_of_step = _located(batch, rows)
            increment, noise = np.empty((0, space.pose)), np.empty((0, space.pose, space.pose))
            poses = int(pose_of_step.max(initial=0)) + 1
        else:
            increment, noise = increments(motion, batch, None)
            pose_of_step = np.searchsorted(batch.control_step, np.arange(batch.steps), side="right")
            poses = len(increment) + 1
        numbers: dict[str, int] = {}
        names = [batch.landmark[i] for i in rows.tolist()]
        landmark = np.array([numbers.setdefault(name, len(numbers)) for name in names], dtype=np.int64)
        pose, root = pose_of_step[batch.observation_step[rows]], information_root(_noise(batch, observation, rows))
        return Problem(
            space=space,
            poses=poses,
            increment=increment,
            increment_root=information_root(noise),
            readings=Readings(observation, pose, landmark, z[rows], root),
            depths=_depths(observation, pose, landmark),
            body=body[rows],
            known=np.maximum.accumulate(landmark) + 1,
            ids=tuple(numbers),
            pose_of_step=pose_of_step,
        )

    @property
    def freedom(self) -> int:
        """Residuals less unknowns."""
        measured = self.increment.size + self.readings.z.size + len(self.depths)
        return measured - self.space.pose * (self.poses - 1) - self.space.dim * len(self.ids)

    def moved_back(self, state: State, stop: int, step: Floats) -> State:
        """The state less a step of the poses before ``stop``, the origin's left out, and of the first landmarks."""
        pose, dim = self.space.pose, self.space.dim
        free = pose * (stop - 1)
        there = State(state.poses.copy(), state.landmarks.copy())
        equations = _EQUATIONS[self.space.name]
        there.poses[1:stop] = equations.moved_back(there.poses[1:stop], step[:free].reshape(-1, pose))
        there.landmarks[: (len(step) - free) // dim] -= step[free:].reshape(-1, dim)
        return there

    # -- beginning ---------------------------------------------------------------------------

    def extend(self, state: State, start: int, stop: int) -> None:
        """Begin poses, by dead reckoning or from what they see, and landmarks where they were first seen."""
        if len(self.increment) < self.poses - 1:
            for k in range(start, stop):
                self._locate(state, k)
                self._place(state, k, k + 1)
        else:
            equations = _EQUATIONS[self.space.name]
            for k in range(max(start, 1), stop):
                state.poses[k] = equations.composed(state.poses[k - 1], self.increment[k - 1])
            self._place(state, start, stop)

    def _place(self, state: State, start: int, stop: int) -> None:
        """Begin the landmarks that poses from ``start`` to ``stop`` are the first to see."""
        first, landmark = self.readings.before(start), self.readings.landmark
        before = int(self.known[first - 1]) if first else 0
        rows = np.arange(first, self.readings.before(stop))
        numbers, where = np.unique(landmark[rows], return_index=True)
        rows = rows[where[numbers >= before]]
        poses = state.poses[self.readings.pose[rows]]
        state.landmarks[landmark[rows]] = _EQUATIONS[self.space.name].to_map(poses, self.body[rows])

    def _locate(self, state: State, k: int) -> None:
        """Put a pose where it lays what it sees onto the landmarks that are known."""
        first, landmark = self.readings.before(k), self.readings.landmark
        if first == 0:
            return
        rows = np.arange(first, self.readings.before(k + 1))
        rows = rows[landmark[rows] < self.known[first - 1]]
        state.poses[k] = align(self.body[rows], state.landmarks[landmark[rows]]).pose

    # -- the normal equations ----------------------------------------------------------------

    def motion_rows(self, state: State, stop: int) -> tuple[Floats, Floats]:
        """Residuals (c, pose) and their derivatives (c, pose, 2 pose) by the poses before and after."""
        increment, root = self.increment[: stop - 1], self.increment_root[: stop - 1]
        pose = state.poses[: len(increment) + 1]
        return _EQUATIONS[self.space.name].moved(pose[:-1], pose[1:], increment, root)

    def observation_rows(self, state: State, stop: int) -> tuple[Floats, Floats]:
        """Residuals (m, channels) and their derivatives (m, channels, pose + dim) by pose and landmark."""
        return self.readings.rows(_EQUATIONS[self.space.name], state, stop)

    def linearise(self, state: State, stop: int) -> Linearised:
        """Whitened residuals of the poses before ``stop`` and their Jacobian, the origin's columns left out."""
        space, count = self.space, self.readings.before(stop)
        moves = self.motion_rows(state, stop)
        by_move = space.pose * np.arange(len(moves[0]))[:, None] + np.arange(2 * space.pose)
        blocks = [(*moves, by_move), (*self.observation_rows(state, stop), self.readings.columns(space, stop))]
        if len(self.depths):
            depths = self.depths.rows(_EQUATIONS[space.name], state, stop)
            blocks.append((*depths, self.depths.columns(space, stop)))
        residual = np.concatenate([left.ravel() for left, _, _ in blocks])
        values = np.concatenate([by.ravel() for _, by, _ in blocks])
        columns = np.concatenate([np.repeat(into, by.shape[1], axis=0).ravel() for _, by, into in blocks])
        widths = np.concatenate([np.full(left.size, by.shape[2]) for left, by, _ in blocks])
        starts = np.concatenate([[0], np.cumsum(widths)])
        known = int(self.known[count - 1]) if count else 0
        shape = (residual.shape[0], space.pose * stop + space.dim * known)
        jacobian = sparse.csr_matrix((values, columns, starts), shape=shape).tocsc()[:, space.pose :]
        return Linearised(float(residual @ residual), residual, jacobian)


def _noise(batch: Batch, observation: ObservationConfig, rows: Ints) -> Floats:
    """Covariances (m, channels, channels) of some observations."""
    if batch.observation_covariance is not None:
        return batch.observation_covariance[rows]
    channels = len(observation.channels)
    return np.broadcast_to(np.diag(np.square(observation.sigma)), (len(rows), channels, channels))


def _depths(observation: ObservationConfig, pose: Ints, landmark: Ints) -> Readings:
    """The prior on each landmark's distance ahead of the sensor, as a reading of its third coordinate there."""
    numbers, first = np.unique(landmark, return_index=True)
    if observation.model != "pinhole" or observation.depth is None:
        numbers, first = numbers[:0], first[:0]
    mean, sigma = (observation.depth.mean, observation.depth.sigma) if observation.depth else (0.0, 1.0)
    z, root = np.zeros((len(first), 3)), np.zeros((len(first), 3, 3))
    z[:, 2], root[:, 2, 2] = mean, 1.0 / sigma
    point = ObservationConfig("cartesian3d", (sigma,) * 3, observation.mount if observation.depth else ())
    return Readings(point, pose[first], numbers, z, root)


def _placeable(batch: Batch, z: Floats, body: Floats) -> Ints:
    """Observations of landmarks of which that reading or one before shows where they are."""
    shown = np.atleast_1d(np.isfinite(body).all(axis=1) | ~np.isfinite(z).all(axis=1))
    known: set[str] = set()
    rows = []
    for i, (name, is_shown) in enumerate(zip(batch.landmark, shown.tolist(), strict=True)):
        if is_shown:
            known.add(name)
        if name in known:
            rows.append(i)
    return np.array(rows, dtype=np.int64)


def _located(batch: Batch, rows: Ints) -> tuple[Ints, Ints]:
    """Of observations those made where enough known landmarks are seen, or first; and the poses of steps (n,)."""
    known: set[str] = set()
    pose_of_step = np.full(batch.steps, -1, dtype=np.int64)
    kept: list[int] = []
    bounds = np.searchsorted(batch.observation_step[rows], np.arange(batch.steps + 1))
    poses = 0
    for step in range(batch.steps):
        own = rows[bounds[step] : bounds[step + 1]].tolist()
        names = [batch.landmark[i] for i in own]
        if own and (not known or sum(name in known for name in names) >= _LEAST_KNOWN):
            pose_of_step[step] = poses
            poses += 1
            known.update(names)
            kept += own
    return np.array(kept, dtype=np.int64), pose_of_step
