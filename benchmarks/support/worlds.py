"""Worlds that robots can drive in for ever: a straight street, a city grid, a park; batches on demand.

A lap is driven again and again. Geometry is worked out once; noise is drawn, and landmarks are
named, when a batch is asked for.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from submaps.config import MotionConfig, ObservationConfig
from submaps.measurements import Batch

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

STEP_M, STEP_S = 1.0, 0.1
MOTION = MotionConfig("odometry", (0.02, 0.01, 0.002))
OBSERVATION = ObservationConfig("cartesian", (0.1, 0.1))
_SPACING_M, _ASIDE_M, _STREET_RANGE_M = 12.5, 5.0, 12.0  # landmarks along both sides of a street
_BLOCK_M = 50.0
_CELL_M, _PARK_RANGE_M = 5.0, 6.25


@dataclass(frozen=True)
class Lap:
    """A drive that ends where it begins, and what is seen from each of its n poses.

    ``increments`` (n, 3) lead from each pose to the next (m, m, rad, in its body frame), the last
    to the first pose. ``seen`` (s,) are landmark numbers and ``points`` (s, 2) where they lie in the
    body frame (m), those of pose k from ``offsets[k]`` to ``offsets[k + 1]``. Where ``endless``, each
    lap passes ``landmarks`` new ones.
    """

    name: str
    increments: Floats
    offsets: Ints
    seen: Ints
    points: Floats
    landmarks: int
    endless: bool = False

    @property
    def steps(self) -> int:
        """Poses of one lap."""
        return int(self.increments.shape[0])


def _lap(name: str, poses: Floats, landmarks: Floats, reach: float, numbers: Ints | None = None) -> Lap:
    """The lap through ``poses`` (n, 3) among ``landmarks`` (m, 2), seen within ``reach`` (m)."""
    found = cKDTree(landmarks).query_ball_point(poses[:, :2], reach, return_sorted=True)
    counts = np.array([len(one) for one in found])
    index = np.concatenate([np.array(one, dtype=np.int64) for one in found])
    at = np.repeat(np.arange(poses.shape[0]), counts)
    points = _to_body(poses[at], landmarks[index])
    following = np.roll(poses, -1, axis=0)
    turn = np.remainder(following[:, 2] - poses[:, 2] + math.pi, 2.0 * math.pi) - math.pi
    increments = np.column_stack([_to_body(poses, following[:, :2]), turn])
    offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    return Lap(name, increments, offsets, index if numbers is None else numbers[index], points, landmarks.shape[0])


def _to_body(poses: Floats, points: Floats) -> Floats:
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    d = points - poses[:, :2]
    return np.column_stack([c * d[:, 0] + s * d[:, 1], -s * d[:, 0] + c * d[:, 1]])


def _along(corners: list[tuple[float, float]]) -> Floats:
    """Poses (n, 3) a step apart along a closed line of straight legs, the last corner left out."""
    legs = []
    for (x0, y0), (x1, y1) in zip(corners, corners[1:] + corners[:1], strict=True):
        count = round(math.hypot(x1 - x0, y1 - y0) / STEP_M)
        part = np.arange(1, count + 1)[:, np.newaxis] / max(count, 1)
        heading = np.full((count, 1), math.atan2(y1 - y0, x1 - x0))
        legs.append(np.hstack([(x0, y0) + part * (x1 - x0, y1 - y0), heading]))
    return np.concatenate(legs)


def _kerbs(lines: list[tuple[bool, float]], length: float) -> Floats:
    """Landmarks along both sides of streets, each (across, where), from 0 to ``length`` (m)."""
    along = np.arange(0.5 * _SPACING_M, length, _SPACING_M)
    sides = []
    for across, where in lines:
        for side in (-_ASIDE_M, _ASIDE_M):
            line = np.full_like(along, where + side)
            sides.append(np.column_stack([line, along] if across else [along, line]))
    return np.concatenate(sides)


def street(length: float = 5000.0) -> Lap:
    """A street without end, the same every ``length`` (m), its landmarks new each time."""
    length = math.ceil(length / _SPACING_M) * _SPACING_M
    landmarks = _kerbs([(False, 0.0)], length)
    count = landmarks.shape[0]
    x = np.arange(round(length / STEP_M)) * STEP_M
    poses = np.column_stack([x, np.zeros_like(x), np.zeros_like(x)])
    before_and_after = np.concatenate([landmarks + (k * length, 0.0) for k in (-1, 0, 1)])
    lap = _lap("street", poses, before_and_after, _STREET_RANGE_M, np.arange(-count, 2 * count))
    increments = np.tile([STEP_M, 0.0, 0.0], (lap.steps, 1))
    return Lap("street", increments, lap.offsets, lap.seen, lap.points, count, endless=True)


def grid(blocks: int = 8) -> Lap:
    """All streets of a city of ``blocks`` by ``blocks``: those along x, then those across, and back."""
    side = blocks * _BLOCK_M
    lines = [k * _BLOCK_M for k in range(blocks + 1)]
    corners: list[tuple[float, float]] = []
    for k, y in enumerate(lines):
        corners += [(0.0, y), (side, y)] if k % 2 == 0 else [(side, y), (0.0, y)]
    east = corners[-1][0] > 0.0
    for k, x in enumerate(reversed(lines) if east else lines):
        corners += [(x, side), (x, 0.0)] if k % 2 == 0 else [(x, 0.0), (x, side)]
    if corners[-1][1] > 0.0:
        corners.append((corners[-1][0], 0.0))
    landmarks = _kerbs([(across, where) for across in (False, True) for where in lines], side)
    return _lap("grid", _along(_without_repeats(corners)), landmarks, _STREET_RANGE_M)


def _without_repeats(corners: list[tuple[float, float]]) -> list[tuple[float, float]]:
    return [corner for corner, before in zip(corners, corners[-1:] + corners[:-1], strict=True) if corner != before]


def park(landmarks: int = 2000) -> Lap:
    """Scattered landmarks, one a cell of 25 m², in lanes there and back; some five in sight, wherever.

    Every second row of cells is a lane; the rows between are seen from the lanes at both sides.
    """
    rows = max(3, 2 * round((math.sqrt(landmarks) / 2 - 1) / 2) + 1)
    columns = math.ceil(landmarks / rows)
    cells = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)[:landmarks]
    aside = np.random.default_rng(landmarks).uniform(-0.2, 0.2, cells.shape)
    west, east = _CELL_M, max((columns - 1) * _CELL_M, 2.0 * _CELL_M)
    corners: list[tuple[float, float]] = []
    for k in range(1, rows, 2):
        y = (k + 0.5) * _CELL_M
        corners += [(west, y), (east, y)] if k % 4 == 1 else [(east, y), (west, y)]
    return _lap("park", _along(corners + corners[-2:0:-1]), (cells + 0.5 + aside) * _CELL_M, _PARK_RANGE_M)


WORLDS: dict[str, Callable[[], Lap]] = {"street": street, "grid": grid, "park": park}


class Drive:
    """One robot's way round a lap, from pose ``start`` on: its next batches, noise from ``seed``."""

    def __init__(self, lap: Lap, start: int = 0, seed: int = 0) -> None:
        self.lap = lap
        self.step = 0  # of the next batch
        self._start = start
        self._rng = np.random.default_rng(seed)

    def next(self, steps: int, observations: int | None = None) -> Batch:
        """The next ``steps`` steps, with at most so many ``observations`` in each."""
        lap, rng = self.lap, self._rng
        k = np.arange(self.step, self.step + steps)
        round_, pose = np.divmod(k + self._start, lap.steps)
        counts = lap.offsets[pose + 1] - lap.offsets[pose]
        if observations is not None:
            counts = np.minimum(counts, observations)
        ends = np.cumsum(counts)
        row = np.repeat(lap.offsets[pose] - (ends - counts), counts) + np.arange(ends[-1])
        landmark = lap.seen[row]
        if lap.endless:
            landmark = landmark + lap.landmarks * np.repeat(round_, counts)
        z = lap.points[row] + rng.normal(size=(row.shape[0], 2)) * OBSERVATION.sigma
        moved = np.arange(0 if self.step else 1, steps)
        control = lap.increments[pose[moved] - 1] + rng.normal(size=(moved.shape[0], 3)) * MOTION.sigma
        self.step += steps
        return Batch(
            t=np.asarray(k * STEP_S, dtype=np.float64), control_step=moved,
            control=np.ascontiguousarray(control.T), control_covariance=None,
            observation_step=np.repeat(np.arange(steps), counts), landmark=tuple(map(str, landmark.tolist())),
            z=np.ascontiguousarray(z.T), observation_covariance=None,
        )  # fmt: skip
