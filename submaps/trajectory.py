"""A robot's poses over time, and where it was between two of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Trajectory:
    """Poses (n, 3) in x m, y m, theta rad at times ``t`` (n,) in seconds, which do not fall."""

    t: Floats
    poses: Floats

    def __len__(self) -> int:
        return int(self.t.shape[0])

    def take(self, rows: NDArray[np.int64] | Bools) -> Trajectory:
        """The poses of some rows."""
        return Trajectory(self.t[rows], self.poses[rows])

    def at(self, t: Floats, longest_gap: float) -> tuple[Trajectory, Bools]:
        """Poses at the times ``t`` (m,), and which of them are known: between poses no further apart than the gap (s).

        Straight between two poses, the heading the short way round.
        """
        if len(self) < 2:
            return Trajectory(t, np.full((t.shape[0], 3), np.nan)), np.zeros(t.shape[0], dtype=bool)
        after = np.clip(np.searchsorted(self.t, t), 1, len(self) - 1)
        begin, end = self.t[after - 1], self.t[after]
        span = end - begin
        known = (begin <= t) & (t <= end) & (span <= longest_gap)
        share = np.where(span > 0.0, (t - begin) / np.where(span > 0.0, span, 1.0), 0.0)
        moved = self.poses[after] - self.poses[after - 1]
        moved[:, 2] = wrapped(moved[:, 2])
        poses = self.poses[after - 1] + share[:, np.newaxis] * moved
        poses[:, 2] = wrapped(poses[:, 2])
        return Trajectory(t, poses), known


def wrapped(angle: Floats) -> Floats:
    """Angles (rad) brought into [-pi, pi)."""
    inside: Floats = np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi
    return inside
