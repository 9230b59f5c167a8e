"""How far an estimate lies from the truth: trajectories and landmarks, in the plane and in space.

Absolute and relative error of a trajectory as in Sturm et al., "A benchmark for the evaluation of
RGB-D SLAM systems", IROS 2012, with the association, the pairs and the statistics of the tool evo.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from submaps.alignment import Alignment, align
from submaps.geometry.space import Space
from submaps.residuals import rotated
from submaps.trajectory import Trajectory, composed, turned

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Unit = Literal["frames", "meters"]
_NUMBERS = {2: "two", 3: "three"}


class NothingInCommon(ValueError):
    """There is nothing to compare; the message says what was looked for."""


@dataclass(frozen=True)
class Statistics:
    """Of some errors, none below 0: root mean square, mean, median, largest, and their number."""

    rmse: float
    mean: float
    median: float
    max: float
    count: int

    @staticmethod
    def of(errors: Floats) -> Statistics:
        """The statistics of errors (n,), n at least 1."""
        rmse = float(np.sqrt(np.mean(np.square(errors))))
        return Statistics(rmse, float(errors.mean()), float(np.median(errors)), float(errors.max()), len(errors))


def associate(estimate: Trajectory, truth: Trajectory, most: float) -> tuple[Trajectory, Trajectory]:
    """The poses of both that belong together, no further apart than ``most`` (s).

    For each pose of the shorter trajectory that of the other which is nearest in time, the earlier of
    two equally near. Raises ``NothingInCommon``.
    """
    if len(truth) < len(estimate):
        other, own = associate(truth, estimate, most)
        return own, other
    after = np.searchsorted(truth.t, estimate.t, side="right").clip(0, len(truth) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(truth.t[after] - estimate.t) < np.abs(estimate.t - truth.t[before]), after, before)
    near = np.abs(truth.t[nearest] - estimate.t) <= most
    if not near.any():
        raise NothingInCommon(f"no two poses lie within {most:g} s of each other")
    return estimate.take(near), truth.take(nearest[near])


def absolute_error(estimate: Trajectory, truth: Trajectory, *, aligned: bool = True) -> Statistics:
    """Distances (m) of poses that belong together, after the rigid motion that makes them least, if asked for."""
    points = estimate.positions
    if aligned:
        points = align(points, truth.positions).apply(points)
    return Statistics.of(_lengths(points - truth.positions))


def relative_error(
    estimate: Trajectory, truth: Trajectory, delta: float, unit: Unit = "meters"
) -> tuple[Statistics, Statistics]:
    """Errors of the motion between one pose and a later one, in m and in rad: (Q_i⁻¹ Q_j)⁻¹ (P_i⁻¹ P_j).

    Pairs follow one another, ``delta`` poses apart, or the first pose at which the estimate has gone
    ``delta`` metres. Raises ``NothingInCommon`` where no pair is that far apart.
    """
    ends = _frames(len(estimate), delta) if unit == "frames" else _metres(estimate.positions, delta)
    if len(ends) < 2:
        raise NothingInCommon(f"no two poses lie {delta:g} {unit} apart")
    way, turn = _motions(estimate, ends)
    true_way, true_turn = _motions(truth, ends)
    return Statistics.of(_lengths(way - true_way)), Statistics.of(_lengths(turned(true_turn, turn)))


def _frames(poses: int, delta: float) -> Ints:
    return np.arange(0, poses, max(int(delta), 1))


def _metres(points: Floats, delta: float) -> Ints:
    ends, way = [0], 0.0
    for i, length in enumerate(_lengths(np.diff(points, axis=0)).tolist(), start=1):
        way += length
        if way >= delta:
            ends.append(i)
            way = 0.0
    return np.array(ends)


def _motions(track: Trajectory, ends: Ints) -> tuple[Floats, Floats]:
    """From each end to the next, in the frame of the first of the two: the way (m) and the turn (rad)."""
    before, after = track.take(ends[:-1]), track.take(ends[1:])
    way = _rotated(track.space, -before.angles, after.positions - before.positions)
    return way, turned(before.angles, after.angles)


def _rotated(space: Space, angles: Floats, points: Floats) -> Floats:
    """Points (n, dim) turned by one rotation each, (n, 1) or (n, 3) rad."""
    if space.dim == 2:
        return rotated(angles[:, 0], points)
    return np.asarray(Rotation.from_rotvec(angles).apply(points))


def _lengths(vectors: Floats) -> Floats:
    return np.asarray(np.linalg.norm(vectors, axis=1))


@dataclass(frozen=True)
class PointError:
    """Distances (m) of points from the truth after a rigid motion, and their NEES per degree of freedom.

    NEES is Σ eᵀP⁻¹e with the (d, d) covariance of each point. The motion takes 3 of the 2n degrees of
    freedom, in space 6 of 3n, so the sum is divided by what is left. It also takes away what is
    uncertain of the frame as a whole, which is part of each P: above 1 the covariances are too small,
    below 1 says little.
    """

    statistics: Statistics
    nees: float
    alignment: Alignment


def point_error(points: Floats, covariances: Floats, truth: Floats) -> PointError:
    """Errors of points (n, d) with covariances (n, d, d) m²; raises ``NothingInCommon`` below d points."""
    count, dim = points.shape
    if count < dim:
        raise NothingInCommon(f"{count} landmark(s) of the truth are in the map, expected {_NUMBERS[dim]} or more")
    motion = align(points, truth)
    error = motion.apply(points) - truth
    squares = _squares(error @ motion.space.rotation(motion.pose), covariances)
    freedom = dim * count - motion.space.pose
    return PointError(Statistics.of(_lengths(error)), float(squares.sum()) / freedom, motion)


def pose_nees(poses: Floats, covariances: Floats, truth: Floats, motion: Alignment) -> float:
    """NEES per degree of freedom of poses (n, p) with covariances (n, p, p), moved as landmarks were.

    The error is that of the covariances: additive in position, about the frame's axes in rotation.
    """
    space = motion.space
    R, dim = space.rotation(motion.pose), space.dim
    position = (truth[:, :dim] - motion.apply(poses[:, :dim])) @ R
    there = composed(-motion.angles[np.newaxis], truth[:, dim:])
    error = np.hstack([position, composed(there, -poses[:, dim:])])
    return float(_squares(error, covariances).mean()) / space.pose


def _squares(error: Floats, covariances: Floats) -> Floats:
    """eᵀP⁻¹e of errors (n, d)."""
    whitened = np.linalg.solve(covariances, error[:, :, np.newaxis])[:, :, 0]
    return np.asarray(np.sum(error * whitened, axis=1))
