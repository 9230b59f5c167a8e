"""A robot's poses over time, and where it was between two of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from submaps.geometry.space import SPACES, Space

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

_OF_POSES = {space.pose: space for space in SPACES.values()}


@dataclass(frozen=True)
class Trajectory:
    """Poses at times ``t`` (n,) in seconds, which do not fall.

    ``poses`` are (n, 3), x m, y m, theta rad; in space (n, 6), x, y, z m and a rotation vector, rad.
    """

    t: Floats
    poses: Floats

    def __len__(self) -> int:
        return int(self.t.shape[0])

    @property
    def space(self) -> Space:
        """Whether the poses are of the plane or of space."""
        return _OF_POSES[self.poses.shape[1]]

    @property
    def positions(self) -> Floats:
        """(n, 2) or (n, 3), m."""
        return self.poses[:, : self.space.dim]

    @property
    def angles(self) -> Floats:
        """Headings (n, 1), or rotation vectors (n, 3), rad."""
        return self.poses[:, self.space.dim :]

    def take(self, rows: NDArray[np.int64] | Bools) -> Trajectory:
        """The poses of some rows."""
        return Trajectory(self.t[rows], self.poses[rows])

    def at(self, t: Floats, longest_gap: float) -> tuple[Trajectory, Bools]:
        """Poses at the times ``t`` (m,), and which of them are known: between poses no further apart than the gap (s).

        Straight between two poses, the rotation at a constant rate the short way round.
        """
        if len(self) < 2:
            return Trajectory(t, np.full((t.shape[0], self.space.pose), np.nan)), np.zeros(t.shape[0], dtype=bool)
        after = np.clip(np.searchsorted(self.t, t), 1, len(self) - 1)
        begin, end = self.t[after - 1], self.t[after]
        span = end - begin
        known = (begin <= t) & (t <= end) & (span <= longest_gap)
        share = np.where(span > 0.0, (t - begin) / np.where(span > 0.0, span, 1.0), 0.0)[:, np.newaxis]
        positions = self.positions[after - 1] + share * (self.positions[after] - self.positions[after - 1])
        turn = share * turned(self.angles[after - 1], self.angles[after])
        return Trajectory(t, np.hstack([positions, composed(self.angles[after - 1], turn)])), known


def composed(a: Floats, b: Floats) -> Floats:
    """R_a R_b, row by row, as headings (n, 1) or rotation vectors (n, 3) no longer than pi; rows of one repeat."""
    if a.shape[1] == 1:
        return wrapped(a + b)
    return np.asarray((Rotation.from_rotvec(a) * Rotation.from_rotvec(b)).as_rotvec())


def turned(a: Floats, b: Floats) -> Floats:
    """The turn from one rotation to the other, R_aᵀ R_b, row by row, in the form of ``composed``."""
    return composed(-a, b)


def wrapped(angle: Floats) -> Floats:
    """Angles (rad) brought into [-pi, pi)."""
    inside: Floats = np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi
    return inside
