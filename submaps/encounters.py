"""Robots that see one another: the seen one's position at that moment is a point that both hold.

To the robot that sees, it is an observation of a new landmark. The robot that is seen marks its own
position there: a landmark at the body's origin, correlated with the pose as it should be. So the two
sub-maps share a point, and it ties them like any other. A mark between two steps splits the control
that lies there: D into exp(a log D) and exp((1 - a) log D), its noise in proportion, turned with the frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from submaps.geometry.space import PLANE, SOLID, Space
from submaps.measurements import Floats, Ints

Mark = tuple[float, int]


@dataclass(frozen=True)
class Columns:
    """What the compiled walk takes in of one robot: increments, observations, and marks among them.

    ``own`` (m,) says where an observation marks the robot's own position: 1, or 2 on a step that is
    there for marks alone. ``R`` holds one covariance for all observations or one for each.
    """

    t: Floats
    control_step: Ints
    increments: Floats
    noises: Floats
    observation_step: Ints
    landmark: Ints
    z: Floats
    R: Floats
    own: NDArray[np.uint8]

    @property
    def each(self) -> Floats:
        """Covariance (m, 2, 2) of each observation."""
        count = self.landmark.shape[0]
        return np.repeat(self.R, count, axis=0) if self.R.shape[0] == 1 else self.R[:count]

    def only(self, keep: NDArray[np.bool_]) -> Columns:
        """The same with some of the observations."""
        return replace(
            self, observation_step=self.observation_step[keep], landmark=self.landmark[keep],
            z=np.ascontiguousarray(self.z[:, keep]), R=self.R if self.R.shape[0] == 1 else one_each(self.each[keep]),
            own=self.own[keep],
        )  # fmt: skip

    def since(self, step: int) -> Columns:
        """The steps from one on, its control left out."""
        control, seen = self.control_step > step, self.observation_step >= step
        c = self.only(seen)
        return replace(
            c, t=self.t[step:], control_step=self.control_step[control] - step, increments=self.increments[control],
            noises=self.noises[control], observation_step=c.observation_step - step,
        )  # fmt: skip

    def then(self, after: Columns) -> Columns:
        """These columns and those that follow them."""
        count = self.t.shape[0]
        R = self.R
        if R.shape[0] != 1 or after.R is not R:
            R = one_each(np.concatenate([self.each, after.each]))
        return Columns(
            t=np.concatenate([self.t, after.t]),
            control_step=np.concatenate([self.control_step, after.control_step + count]),
            increments=np.concatenate([self.increments, after.increments]),
            noises=np.concatenate([self.noises, after.noises]),
            observation_step=np.concatenate([self.observation_step, after.observation_step + count]),
            landmark=np.concatenate([self.landmark, after.landmark]),
            z=np.concatenate([self.z, after.z], axis=1),
            R=R,
            own=np.concatenate([self.own, after.own]),
        )


@dataclass(frozen=True)
class Marked:
    """Columns with marks, and where the steps and observations from before lie among theirs."""

    columns: Columns
    steps: Ints
    observations: Ints


def with_marks(columns: Columns, before: float | None, marks: Sequence[Mark]) -> Marked:
    """Columns in which the robot marks its position at each time (s), as a landmark's number.

    ``before`` is the time of the step before the first (``None``: there is none, and nothing can be
    marked earlier). Marks lie after it, and not after the last step.
    """
    t = columns.t
    times = np.array([tau for tau, _ in marks])
    fresh = np.setdiff1d(times, t)
    if before is None:
        fresh = fresh[fresh > t[0]]
    place = np.searchsorted(t, fresh)  # each goes before this step
    steps = np.arange(t.shape[0]) + np.searchsorted(fresh, t)
    whole_t = np.insert(t, place, fresh)
    control_step, increments, noises = _split(columns, t[0] if before is None else before, fresh, place, steps)
    where = np.searchsorted(whole_t, times, side="right") - 1
    good = (where >= 0) & (whole_t[np.maximum(where, 0)] == times)
    count, added = columns.observation_step.shape[0], int(np.count_nonzero(good))
    step = np.concatenate([steps[columns.observation_step], where[good]])
    order = np.argsort(step, kind="stable")
    observations = np.empty(count + added, dtype=np.int64)
    observations[order] = np.arange(count + added)
    numbers = np.array([number for _, number in marks], dtype=np.int64)[good]
    marked = Columns(
        t=whole_t, control_step=control_step, increments=increments, noises=noises, observation_step=step[order],
        landmark=np.concatenate([columns.landmark, numbers])[order],
        z=np.ascontiguousarray(np.concatenate([columns.z, np.zeros((columns.z.shape[0], added))], axis=1)[:, order]),
        R=one_each(np.concatenate([columns.each, np.zeros((added, *columns.R.shape[1:]))])[order]),
        own=np.concatenate([columns.own, np.where(np.isin(times[good], fresh), 2, 1).astype(np.uint8)])[order],
    )  # fmt: skip
    return Marked(marked, steps, observations[:count])


def one_each(R: Floats) -> Floats:
    """One covariance for each observation; a single one would read as that of all."""
    return R if R.shape[0] != 1 else np.repeat(R, 2, axis=0)


def _split(columns: Columns, before: float, fresh: Floats, place: Ints, steps: Ints) -> tuple[Ints, Floats, Floats]:
    """Controls on the new steps: one that covers fresh times is cut there."""
    where: list[int] = []
    increments: list[Floats] = []
    noises: list[Floats] = []
    pose = columns.increments.shape[1]
    space = PLANE if pose == PLANE.pose else SOLID
    for k, step in enumerate(columns.control_step.tolist()):
        inside = fresh[place == step]
        begin = float(columns.t[step - 1]) if step else before
        cuts = np.array([begin, *inside, columns.t[step]])
        parts = np.diff(cuts) / (cuts[-1] - begin) if inside.size else np.ones(1)
        twist = np.array(space.log(space.as_pose(columns.increments[k])))
        gone = np.zeros(space.rot)
        for i, part in enumerate(parts):
            where.append(int(steps[step]) - parts.shape[0] + 1 + i)
            increments.append(
                np.array(space.exp(space.as_pose(part * twist))) if inside.size else columns.increments[k]
            )
            noises.append(part * _turned(space, columns.noises[k], -gone) if inside.size else columns.noises[k])
            gone = gone + part * twist[space.dim :]
    noise = np.array(noises).reshape(-1, pose, pose)
    return np.array(where, dtype=np.int64), np.array(increments).reshape(-1, pose), noise


def _turned(space: Space, Q: Floats, angles: Floats) -> Floats:
    """B Q B^T with B = diag(R, R), in the plane diag(R, 1): how a pose's error is seen from a turned frame."""
    B = np.eye(space.pose)
    for at in range(0, space.pose - 1, space.dim):
        B[at : at + space.dim, at : at + space.dim] = space.rotation_of(angles)
    whole = _product(_product(B, Q), B.T)
    return 0.5 * (whole + whole.T)


def _product(A: Floats, B: Floats) -> Floats:
    """A B without BLAS: what touches state gives the same bits everywhere."""
    out: Floats = np.sum(A[:, :, np.newaxis] * B, axis=1)
    return out
