"""How far an estimate lies from the truth: trajectories and landmarks, in the plane.

Absolute and relative error of a trajectory as in Sturm et al., "A benchmark for the evaluation of
RGB-D SLAM systems", IROS 2012, with the association, the pairs and the statistics of the tool evo.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from submaps.alignment import Alignment, align
from submaps.residuals import rotated
from submaps.trajectory import Trajectory, wrapped

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Unit = Literal["frames", "meters"]


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
    points = estimate.poses[:, :2]
    if aligned:
        points = align(points, truth.poses[:, :2]).apply(points)
    return Statistics.of(np.hypot(*(points - truth.poses[:, :2]).T))


def relative_error(
    estimate: Trajectory, truth: Trajectory, delta: float, unit: Unit = "meters"
) -> tuple[Statistics, Statistics]:
    """Errors of the motion between one pose and a later one, in m and in rad: (Q_i⁻¹ Q_j)⁻¹ (P_i⁻¹ P_j).

    Pairs follow one another, ``delta`` poses apart, or the first pose at which the estimate has gone
    ``delta`` metres. Raises ``NothingInCommon`` where no pair is that far apart.
    """
    ends = _frames(len(estimate), delta) if unit == "frames" else _metres(estimate.poses[:, :2], delta)
    if len(ends) < 2:
        raise NothingInCommon(f"no two poses lie {delta:g} {unit} apart")
    own, true = _motions(estimate.poses, ends), _motions(truth.poses, ends)
    turn = wrapped(own[:, 2] - true[:, 2])
    return Statistics.of(np.hypot(*(own - true)[:, :2].T)), Statistics.of(np.abs(turn))


def _frames(poses: int, delta: float) -> Ints:
    return np.arange(0, poses, max(int(delta), 1))


def _metres(points: Floats, delta: float) -> Ints:
    ends, way = [0], 0.0
    for i, length in enumerate(np.hypot(*np.diff(points, axis=0).T).tolist(), start=1):
        way += length
        if way >= delta:
            ends.append(i)
            way = 0.0
    return np.array(ends)


def _motions(poses: Floats, ends: Ints) -> Floats:
    """From each end to the next, in the frame of the first of the two."""
    before, after = poses[ends[:-1]], poses[ends[1:]]
    return np.column_stack([rotated(-before[:, 2], after[:, :2] - before[:, :2]), after[:, 2] - before[:, 2]])


@dataclass(frozen=True)
class PointError:
    """Distances (m) of points from the truth after a rigid motion, and their NEES per degree of freedom.

    NEES is Σ eᵀP⁻¹e with the (2, 2) covariance of each point. The motion takes 3 of the 2n degrees of
    freedom, so the sum is divided by 2n - 3. It also takes away what is uncertain of the frame as a
    whole, which is part of each P: above 1 the covariances are too small, below 1 says little.
    """

    statistics: Statistics
    nees: float
    alignment: Alignment


def point_error(points: Floats, covariances: Floats, truth: Floats) -> PointError:
    """Errors of points (n, 2) with covariances (n, 2, 2) m²; raises ``NothingInCommon`` below two points."""
    if len(points) < 2:
        raise NothingInCommon(f"{len(points)} landmark(s) of the truth are in the map, expected two or more")
    motion = align(points, truth)
    error = motion.apply(points) - truth
    freedom = 2 * len(points) - 3
    squares = _squares(rotated(-motion.theta, error), covariances)
    return PointError(Statistics.of(np.hypot(*error.T)), float(squares.sum()) / freedom, motion)


def pose_nees(poses: Floats, covariances: Floats, truth: Floats, motion: Alignment) -> float:
    """NEES per degree of freedom of poses (n, 3) with covariances (n, 3, 3), moved as landmarks were."""
    error = truth - np.column_stack([motion.apply(poses[:, :2]), poses[:, 2] + motion.theta])
    error[:, :2] = rotated(-motion.theta, error[:, :2])
    error[:, 2] = wrapped(error[:, 2])
    return float(_squares(error, covariances).mean()) / 3.0


def _squares(error: Floats, covariances: Floats) -> Floats:
    """eᵀP⁻¹e of errors (n, d)."""
    whitened = np.linalg.solve(covariances, error[:, :, np.newaxis])[:, :, 0]
    return np.asarray(np.sum(error * whitened, axis=1))
