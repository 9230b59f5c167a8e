"""A world in which every rotation is known: all is linear, and the answer has a closed form.

On a line these are the beads of the lecture's BeadSLAM; in the plane or in space a robot whose
heading is known for certain. The closed form is one least-squares problem over everything that
happened, and a filter's last estimate has to equal it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from submaps.reference import ekf
from submaps.reference.ekf import Estimate
from submaps.reference.observation import Point, Sighting
from submaps.reference.retraction import Retraction
from submaps.reference.space import LINE, Geometry, turned

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Record:
    """What a robot measured: K moves and the sightings after each, in d dimensions.

    ``increments`` (K, d + t) are in the body frame of the pose before, their first d with covariance
    ``Q`` (d, d), their turns certain; ``seen[k]`` lists (landmark, reading (d,)) at pose k, with
    covariance ``R`` (d, d). ``start`` (d + t,) is the first pose, ``P0`` (d, d) its position's uncertainty.
    """

    space: Geometry
    increments: Floats
    seen: tuple[tuple[tuple[int, Floats], ...], ...]
    Q: Floats
    R: Floats
    start: Floats
    P0: Floats


def closed_form(record: Record, landmarks: int) -> tuple[Floats, Floats]:
    """Mean and covariance of (last position, landmarks), (d + d m,), each landmark seen at least once.

    argmin of the sum of squares of the whitened prior, moves R_k^T (p_{k+1} - p_k) and readings
    R_k^T (l - p_k); the covariance is the inverse of its information matrix.
    """
    d, count = record.space.dim, len(record.seen)
    size = d * (count + landmarks)
    information, right = np.zeros((size, size)), np.zeros(size)

    def add(to: int, origin: int | None, value: Floats, back: Floats, covariance: Floats) -> None:
        A = back if origin is None else np.hstack([back, -back])
        at = np.concatenate([d * k + np.arange(d) for k in (to, origin) if k is not None])
        weighted = np.linalg.solve(covariance, A)
        information[np.ix_(at, at)] += A.T @ weighted
        right[at] += weighted.T @ value

    theta = record.start[d:]
    add(0, None, record.start[:d], np.eye(d), record.P0)
    for k in range(count):
        if k:
            move = record.increments[k - 1]
            add(k, k - 1, move[:d], record.space.rotation_of(theta).T, record.Q)
            theta = turned(record.space, theta, move[d:])
        for i, reading in record.seen[k]:
            add(count + i, k, reading, record.space.rotation_of(theta).T, record.R)
    last = np.arange(d * (count - 1), size)
    covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
    return (covariance @ right)[last], covariance[np.ix_(last, last)]


def filtered(
    record: Record, retraction: Retraction, *, each: bool = False
) -> Iterator[tuple[Estimate, dict[int, int]]]:
    """The estimate after each pose's sightings, with the slot of each landmark, by the EKF.

    Sightings are taken jointly, or landmark by landmark where ``each`` is set.
    """
    update = ekf.update_each if each else ekf.update
    d, k = record.space.dim, record.space.pose
    P0, noise = np.zeros((2, k, k))
    P0[:d, :d], noise[:d, :d] = record.P0, record.Q
    estimate, slots = ekf.start(retraction, record.start, P0), dict[int, int]()
    for step, seen in enumerate(record.seen):
        if step:
            estimate = ekf.predict(retraction, estimate, record.increments[step - 1], noise)
        known = [Sighting(slots[i], z, record.R, Point()) for i, z in seen if i in slots]
        if known:
            estimate = update(retraction, estimate, known)
        for i, z in seen:
            if i not in slots:
                slots[i] = estimate.x.shape[0]
                estimate = ekf.augment(retraction, estimate, z, record.R, Point())
        yield estimate, dict(slots)


def in_order(space: Geometry, slots: dict[int, int]) -> NDArray[np.int64]:
    """Entries of a filter's state in the closed form's order: the position, then landmarks by number."""
    d = space.dim
    return np.array([*range(d), *(slots[i] + a for i in sorted(slots) for a in range(d))])


@dataclass(frozen=True)
class Beads:
    """The bead world: a vehicle runs to and fro along a wire, past beads that it measures the distance to.

    ``beads`` (m,) m; it moves by ``stride`` (m) a step and turns back at both ends of ``span`` (m), seeing
    what is within ``reach`` (m) of where it means to be. Standard deviations (m): of its first position, of
    a move, of a reading.
    """

    beads: Floats
    span: tuple[float, float]
    stride: float
    reach: float
    start_sigma: float
    move_sigma: float
    reading_sigma: float

    def _expected(self, steps: int) -> list[float]:
        """Where the vehicle would be without noise: to and fro."""
        low, high = self.span
        position, direction, places = low, 1.0, [low]
        for _ in range(steps):
            if not low <= position + direction * self.stride <= high:
                direction = -direction
            position += direction * self.stride
            places.append(position)
        return places

    def _near(self, place: float) -> NDArray[np.int64]:
        return np.flatnonzero(np.abs(self.beads - place) <= self.reach)

    @property
    def limit(self) -> float:
        """The variance (m²) that a landmark's falls to: that of the vehicle at the start, where moves are certain.

        Once the map is rigid, what is left open of it is where the first position lies in it: P0, and,
        where moves are noisy, what all readings together leave open of the first position relative to a
        map that is known, p = 1 / (i + 1 / (p' + q)) from the last step back to the first.
        """
        if self.move_sigma == 0.0:
            return self.start_sigma**2
        left = math.inf
        for place in reversed(self._expected(1000)):
            information = self._near(place).shape[0] / self.reading_sigma**2
            left = 1.0 / (information + 1.0 / (left + self.move_sigma**2))
        return self.start_sigma**2 + left

    def drive(self, steps: int, rng: np.random.Generator) -> tuple[Record, Floats]:
        """A drive of so many moves, and the true positions (steps + 1,) of the vehicle."""
        expected = self._expected(steps)
        moves = np.diff(expected)
        start = expected[0] + self.start_sigma * rng.normal()
        done = moves + self.move_sigma * rng.normal(size=steps)
        truth = start + np.concatenate([[0.0], np.cumsum(done)])
        seen = []
        for place, position in zip(expected, truth, strict=True):
            near = self._near(place)
            readings = self.beads[near] - position + self.reading_sigma * rng.normal(size=near.shape[0])
            seen.append(tuple((int(i), np.array([z])) for i, z in zip(near, readings, strict=True)))
        record = Record(
            LINE, moves[:, np.newaxis], tuple(seen), np.array([[self.move_sigma**2]]),
            np.array([[self.reading_sigma**2]]), np.array([expected[0]]), np.array([[self.start_sigma**2]]),
        )  # fmt: skip
        return record, truth
