"""One bounded sub-map: the arrays that a filter works on, and what is kept of them once closed."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.filtering import layout
from submaps.filtering.closing import CLOSED, STEP, Shelf, flush, pack
from submaps.geometry.space import PLANE, SOLID, Pose, Space

Floats = NDArray[np.float64]


@jit("float64[:, ::1](float64[::1], int64[::1])")
def unpack(packed: Floats, rows: NDArray[np.int64]) -> Floats:
    """(d, d) covariance of the state entries ``rows``, from the packed lower triangle."""
    d = rows.shape[0]
    out = np.empty((d, d))
    for a in range(d):
        for b in range(a + 1):
            i, j = max(rows[a], rows[b]), min(rows[a], rows[b])
            out[a, b] = packed[i * (i + 1) // 2 + j]
            out[b, a] = out[a, b]
    return out


@dataclass(frozen=True, eq=False, slots=True)
class Submap:
    """What a sub-map says, at its close or at one moment of its life; never changed after.

    Most of a map's memory is these, so nothing that can be had again is kept in them.

    ``mean`` is (x m, y m, theta rad, l_1x, l_1y, ...) in the sub-map's own frame: the pose at its
    end, then its landmarks, of which ``landmarks`` holds the map's numbers; in space (x m, y m, z m,
    rotation vector rad, l_1x, l_1y, l_1z, ...). ``packed`` is the lower
    triangle, row by row, of the covariance in the ``invariant`` or the additive error (see ``filtering.kernel``).
    """

    number: int
    robot: int
    previous: int
    following: int
    began: float
    ended: float
    steps: int
    observed_steps: int
    observations: int
    rejected: int
    nis_sum: float
    nis_count: int
    invariant: bool
    landmarks: NDArray[np.int32]
    mean: Floats
    packed: Floats
    _digest: bytes | None = field(default=None, init=False, repr=False)

    @property
    def active(self) -> bool:
        """Whether the robot was still in it."""
        return self.following < 0

    @property
    def space(self) -> Space:
        """The plane or space that it lies in."""
        plane = self.mean.shape[0] == PLANE.pose + PLANE.dim * self.landmarks.shape[0]
        return PLANE if plane else SOLID

    @property
    def pose(self) -> Pose:
        """The pose at its end, in its own frame."""
        return self.space.as_pose(self.mean)

    @property
    def nbytes(self) -> int:
        """Bytes of the estimate."""
        return int(self.mean.nbytes + self.packed.nbytes + self.landmarks.nbytes)

    def slots(self) -> dict[int, int]:
        """Place of each landmark (by the map's number) in ``mean``."""
        space = self.space
        return {number: space.pose + space.dim * i for i, number in enumerate(self.landmarks.tolist())}

    def slot_of(self, landmark: int) -> int:
        """Place of one landmark in ``mean``; it must hold it."""
        space = self.space
        return space.pose + space.dim * int(np.flatnonzero(self.landmarks == landmark)[0])

    def holds(self, landmark: int) -> bool:
        """Whether a landmark (by the map's number) is in it."""
        return bool(np.any(self.landmarks == landmark))

    def digest(self) -> bytes:
        """Digest of the estimate, over everything a solve reads."""
        if self._digest is None:
            whole = np.array([self.number, self.robot, self.previous, self.following, self.invariant])
            digest = hashlib.blake2b(whole.astype("<i8").tobytes(), digest_size=16)
            for array in (self.landmarks.astype("<i4"), self.mean.astype("<f8"), self.packed.astype("<f8")):
                digest.update(array.tobytes())
            object.__setattr__(self, "_digest", digest.digest())
        assert self._digest is not None
        return self._digest

    def covariance(self, rows: NDArray[np.int64] | None = None) -> Floats:
        """Covariance (d, d) of the state entries ``rows`` (all of them by default)."""
        every = np.arange(self.mean.shape[0], dtype=np.int64)
        return unpack(self.packed, every if rows is None else rows)


def _aligned(rows: int, columns: int) -> Floats:
    """Zeros (rows, columns) that start on a cache line."""
    raw = np.zeros(rows * columns + 8)
    first = (-raw.ctypes.data // 8) % 8
    return raw[first : first + rows * columns].reshape(rows, columns)


class ActiveSubmap:
    """The arrays of the sub-map that a robot is in; ``filtering.walk`` changes them in place.

    A robot keeps one for life: when a sub-map has closed, the next begins in the same arrays.
    """

    def __init__(self, number: int, robot: int, began: float, landmarks: int, space: Space = PLANE) -> None:
        self.space = space
        self.number = number
        self.robot = robot
        self.previous = -1
        self.began = began
        self.counts = np.zeros(layout.COUNTS, dtype=np.int64)
        self.counts[layout.DIM] = space.pose
        self.motion = np.zeros(layout.motion_size(space.pose))
        self._allocate(space.pose + space.dim * landmarks)

    def _allocate(self, dimension: int) -> None:
        rows = -(-dimension // 8) * 8
        self.P = _aligned(rows, rows)
        self.x = np.zeros(rows)
        self.ids = np.zeros(rows // 2, dtype=np.int64)
        self.scratch = _aligned(self.space.pose, rows)

    def grow(self, more: int) -> None:
        """Make room for ``more`` further landmarks."""
        n = self.dimension
        x, P, ids = self.x, self.P, self.ids
        self._allocate(n + self.space.dim * more)
        self.x[:n], self.P[:n, :n], self.ids[: ids.shape[0]] = x[:n], P[:n, :n], ids

    @property
    def dimension(self) -> int:
        """Entries of the state."""
        return int(self.counts[layout.DIM])

    @property
    def pose(self) -> Pose:
        """The robot's pose now, in this sub-map's frame."""
        as_pose = self.space.as_pose
        return self.space.compose(as_pose(self.x), as_pose(self.motion[layout.PENDING :]))

    @property
    def landmark_count(self) -> int:
        """How many landmarks it holds."""
        return (self.dimension - self.space.pose) // self.space.dim

    def snapshot(self, ended: float, invariant: bool) -> Submap:
        """What it says now, with the pending increment taken in; its own arrays stay as they are.

        Where the pose's covariance is singular, its missing variance is raised to a floor.
        """
        n, x, P, motion = self.dimension, self.x, self.P, self.motion
        if motion[layout.PENDING :].any():
            x, P, motion = x.copy(), P.copy(), motion.copy()
            flush(self.space.key, x, P, self.counts, motion, invariant, self.scratch)
        packed = np.empty(n * (n + 1) // 2)
        pack(self.space.key, P, n, packed)
        nis = float(motion[layout.NIS_SUM]), int(motion[layout.NIS_COUNT])
        landmarks = self.ids[: self.landmark_count].astype(np.int32)
        return self.as_submap(ended, invariant, -1, self.counts.tolist(), nis, landmarks, x[:n].copy(), packed)

    def as_submap(
        self, ended: float, invariant: bool, following: int, counts: list[int], nis: tuple[float, int],
        landmarks: NDArray[np.int32], mean: Floats, packed: Floats,
    ) -> Submap:  # fmt: skip
        """A record of the sub-map that these arrays were those of."""
        return Submap(
            number=self.number, robot=self.robot, previous=self.previous, following=following,
            began=self.began, ended=ended, steps=counts[layout.STEPS], observed_steps=counts[layout.OBSERVED],
            observations=counts[layout.OBSERVATIONS], rejected=counts[layout.REJECTED],
            nis_sum=nis[0], nis_count=nis[1], invariant=invariant, landmarks=landmarks, mean=mean, packed=packed,
        )  # fmt: skip

    def closed(self, shelf: Shelf, invariant: bool, t: Floats, following: Iterator[int]) -> Iterator[Submap]:
        """Take the sub-maps off the shelf, in order; each makes this the one that follows it."""
        at = first = 0
        for row in range(int(shelf.fill[CLOSED])):
            counts = shelf.whole[row].tolist()
            n = counts[layout.DIM]
            end, last = at + n + n * (n + 1) // 2, first + (n - self.space.pose) // self.space.dim
            mean, packed = shelf.reals[at : at + n].copy(), shelf.reals[at + n : end].copy()
            nis = float(shelf.reals[end]), int(shelf.reals[end + 1])
            landmarks = shelf.ids[first:last].astype(np.int32)
            ended, number = float(t[counts[STEP]]), next(following)
            yield self.as_submap(ended, invariant, number, counts, nis, landmarks, mean, packed)
            self.previous, self.number, self.began = self.number, number, ended
            at, first = end + 2, last
        shelf.clear()
