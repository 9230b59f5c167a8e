"""A robot's increments, composed between the moments that matter: where it saw something, or was seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from submaps.config import MotionConfig
from submaps.geometry.se2 import exp, log
from submaps.measurements import Batch
from submaps.motion.increments import increments
from submaps.residuals import rotated

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Chain:
    """Poses of one robot and what leads from each to the next.

    ``place`` (k,) counts controls: pose i lies after ``floor(place)`` of them and that share of the
    next. ``increment`` (k - 1, 3) and its ``covariance`` are in the frame of the pose before. The first
    place is 0, the robot's first pose.
    """

    place: Floats
    increment: Floats
    covariance: Floats

    def __len__(self) -> int:
        return int(self.place.shape[0])

    def index(self, place: Floats) -> Ints:
        """The poses at places that the chain holds."""
        return np.searchsorted(self.place, place)


def place_of_steps(batch: Batch) -> Ints:
    """How many controls lead to each step."""
    return np.searchsorted(batch.control_step, np.arange(batch.steps), side="right")


def place_at(batch: Batch, t: Floats) -> Floats:
    """Places at times (m,), NaN before the first step and after the last.

    Between two steps the pose moves along the arc of the control that leads from one to the other,
    as far as time has gone on.
    """
    counted = place_of_steps(batch).astype(np.float64)
    after = np.clip(np.searchsorted(batch.t, t), 1, max(batch.steps - 1, 1))
    after = np.minimum(after, batch.steps - 1)
    before = np.maximum(after - 1, 0)
    span = batch.t[after] - batch.t[before]
    share = np.where(span > 0.0, (t - batch.t[before]) / np.where(span > 0.0, span, 1.0), 1.0)
    place = counted[before] + share * (counted[after] - counted[before])
    return np.where((t >= batch.t[0]) & (t <= batch.t[-1]), place, np.nan)


def chain(batch: Batch, motion: MotionConfig, places: Floats) -> Chain:
    """The chain through the given places (any order, repeated or not) and the first pose.

    Part α of an increment exp(ξ) is exp(αξ), with the share α of its covariance. Increments compose
    as they do in the filter: exact in the mean, to first order in the covariance.
    """
    steps, noises = increments(motion, batch, None)
    place = np.unique(np.concatenate([[0.0], places]))
    knots = np.union1d(np.arange(int(place[-1]) + 1, dtype=np.float64), place)
    control = np.floor(knots[:-1]).astype(np.int64)
    share = np.diff(knots)
    pieces, covariances = steps[control], share[:, np.newaxis, np.newaxis] * noises[control]
    split = np.flatnonzero(share < 1.0)
    for i in split.tolist():
        x, y, theta = log((float(pieces[i, 0]), float(pieces[i, 1]), float(pieces[i, 2])))
        pieces[i] = exp((share[i] * x, share[i] * y, share[i] * theta))
    increment, covariance = _composed(pieces, covariances, np.searchsorted(knots, place))
    return Chain(place, increment, covariance)


def _composed(pieces: Floats, covariances: Floats, bounds: Ints) -> tuple[Floats, Floats]:
    """Increments between bounds (k,) of pieces (n, 3), and their covariances.

    An error (e, φ) of a piece that ends at q shifts the end p of its segment by R e + J (p - q) φ.
    """
    if len(bounds) < 2:
        return np.empty((0, 3)), np.empty((0, 3, 3))
    heading = np.concatenate([[0.0], np.cumsum(pieces[:, 2])])
    way = np.vstack([np.zeros(2), np.cumsum(rotated(heading[:-1], pieces[:, :2]), axis=0)])
    begin, end = bounds[:-1], bounds[1:]
    increment = np.column_stack([rotated(-heading[begin], way[end] - way[begin]), heading[end] - heading[begin]])
    segment = np.repeat(np.arange(len(begin)), np.diff(bounds))
    rest = rotated(-heading[begin[segment]], way[end[segment]] - way[1 : len(pieces) + 1])
    turn = heading[:-1] - heading[begin[segment]]
    A = np.zeros((len(pieces), 3, 3))
    A[:, 0, 0] = A[:, 1, 1] = np.cos(turn)
    A[:, 1, 0] = np.sin(turn)
    A[:, 0, 1] = -A[:, 1, 0]
    A[:, 0, 2], A[:, 1, 2], A[:, 2, 2] = -rest[:, 1], rest[:, 0], 1.0
    return increment, np.add.reduceat(A @ covariances @ A.transpose(0, 2, 1), begin, axis=0)
