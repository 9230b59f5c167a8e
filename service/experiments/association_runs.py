"""One run of the ``association`` experiment: a drive with a method, or with one wrong match."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from service.experiments.association_world import CLUTTER, Drive
from service.experiments.one_map import OneMap
from submaps.association.candidates import Candidates
from submaps.association.known import known
from submaps.association.methods import METHODS
from submaps.association.result import AMBIGUOUS, NEW, Association, Gates
from submaps.consistency import nees

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

GATES = Gates(0.99, 0.99999)
FORGOTTEN_AFTER = 5  # scans, where a landmark has been seen in one only

# Of what is known at a step (candidates, truth of the readings, origin of the landmarks) an association.
Choose = Callable[[int, Candidates, Ints, Ints], Association]


@dataclass
class Tally:
    """What became of the readings of a drive.

    Of those of landmarks, ``correct``: given to the landmark that this one's first reading began, or new
    at its first; ``wrong``: given to another; ``missed``: begun a second time, or set aside. Of the
    ``clutter``, ``taken`` for a landmark.
    """

    correct: int = 0
    wrong: int = 0
    missed: int = 0
    clutter: int = 0
    taken: int = 0
    cut_short: int = 0
    seconds: list[float] = field(default_factory=list)

    def count(self, found: Association, truth: Ints, origin: Ints) -> None:
        """Count one scan's."""
        self.cut_short += not found.complete
        for is_, landmark in zip(truth.tolist(), found.landmark.tolist(), strict=True):
            if is_ == CLUTTER:
                self.clutter += 1
                self.taken += landmark >= 0
            elif landmark >= 0:
                right = bool(origin[landmark] == is_)
                self.correct += right
                self.wrong += not right
            else:
                right = landmark == NEW and not bool((origin == is_).any())
                self.correct += right
                self.missed += not right


@dataclass
class Driven:
    """What came out of a drive.

    ``origin`` (n,) names the landmark whose reading began each of the map's, or ``CLUTTER``; those with
    more than one of ``sightings`` (n,) count as landmarks. ``nees`` (steps,) is that of the pose, per
    degree of freedom; ``map_nees`` that of everything, where all of it is of landmarks.
    """

    tally: Tally
    estimate: OneMap
    origin: Ints
    sightings: Ints
    nees: Floats
    map_rmse: float
    map_nees: float


def by_method(name: str) -> Choose:
    """Choose by a method, or by what is ``known``."""
    if name == "known":
        return by_truth
    return lambda _, candidates, truth, origin: METHODS[name](candidates, GATES)


def by_truth(_: int, candidates: Candidates, truth: Ints, origin: Ints) -> Association:
    """Choose as one who knows, clutter included: it is set aside."""
    found = known(candidates, truth, origin)
    return Association(np.where(truth == CLUTTER, AMBIGUOUS, found.landmark), found.nearest, found.squared)


def run(drive: Drive, choose: Choose) -> Driven:
    """Drive with a map that begins empty."""
    state, tally = OneMap(), Tally()
    origin, sightings, age = np.empty((3, 0), dtype=np.int64)
    consistency = []
    for k, scan in enumerate(drive.scans):
        if k:
            state.predict(scan.increment, drive.odometry)
        began = time.perf_counter()
        candidates = state.candidates(scan.z, drive.reading)
        found = choose(k, candidates, scan.truth, origin)
        tally.seconds.append(time.perf_counter() - began)
        tally.count(found, scan.truth, origin)
        matched, fresh = np.flatnonzero(found.matched), np.flatnonzero(found.landmark == NEW)
        state.update(candidates, matched, found.landmark[matched])
        state.augment(scan.z[fresh], drive.reading)
        sightings[found.landmark[matched]] += 1
        origin = np.append(origin, scan.truth[fresh])
        sightings = np.append(sightings, np.ones(fresh.size, dtype=np.int64))
        age = np.append(age + 1, np.zeros(fresh.size, dtype=np.int64))
        stale = np.flatnonzero((sightings == 1) & (age > FORGOTTEN_AFTER))
        if stale.size:
            state.drop(stale)
            origin, sightings, age = (np.delete(a, stale) for a in (origin, sightings, age))
        if k:
            consistency.append(nees(state.error(scan.pose, state.landmarks)[:3], state.P[:3, :3]) / 3.0)
    return _finished(drive, state, tally, origin, sightings, np.array(consistency))


def _finished(drive: Drive, state: OneMap, tally: Tally, origin: Ints, sightings: Ints, consistency: Floats) -> Driven:
    sure = (origin != CLUTTER) & (sightings > 1)
    off = state.landmarks[sure] - drive.landmarks[origin[sure]]
    whole = math.nan
    if (origin != CLUTTER).all():
        xi = state.error(drive.scans[-1].pose, drive.landmarks[origin])
        whole = nees(xi, state.P) / xi.size
    rmse = math.sqrt(float(np.mean(np.sum(off**2, axis=1))))
    return Driven(tally, state, origin, sightings, consistency, rmse, whole)


@dataclass(frozen=True)
class Mistake:
    """A wrong match that could have been made: a reading, not its own landmark, at the least d^2."""

    step: int
    reading: int
    landmark: int
    squared: float
    apart: float  # m, between the two landmarks


def likeliest_mistake(drive: Drive, first: int, last: int) -> Mistake:
    """The likeliest wrong match of a drive with what is known, at one of the steps ``first`` .. ``last``."""
    best = Mistake(0, 0, 0, math.inf, 0.0)

    def choose(step: int, candidates: Candidates, truth: Ints, origin: Ints) -> Association:
        nonlocal best
        found = by_truth(step, candidates, truth, origin)
        free = np.setdiff1d(np.arange(candidates.landmarks), found.landmark)
        rows = np.flatnonzero(found.matched)
        if first <= step <= last and rows.size and free.size:
            squared = candidates.squared[np.ix_(rows, free)]
            i, j = np.unravel_index(np.argmin(squared), squared.shape)
            if squared[i, j] < best.squared:
                is_, other = truth[rows[i]], origin[free[j]]
                apart = math.hypot(*(drive.landmarks[is_] - drive.landmarks[other]))
                best = Mistake(step, int(rows[i]), int(free[j]), float(squared[i, j]), apart)
        return found

    run(drive, choose)
    return best


def with_mistake(drive: Drive, mistake: Mistake, *, made: bool, after: str) -> Driven:
    """Drive with what is known until the ``mistake``, which is made or not, and ``after`` it by a method."""
    later = by_method(after)

    def choose(step: int, candidates: Candidates, truth: Ints, origin: Ints) -> Association:
        if step > mistake.step:
            return later(step, candidates, truth, origin)
        found = by_truth(step, candidates, truth, origin)
        if made and step == mistake.step:
            found.landmark[mistake.reading] = mistake.landmark
        return found

    return run(drive, choose)


@dataclass(frozen=True)
class Example:
    """A scan that misleads the greedy method and not joint compatibility, in the frame of the predicted body.

    ``readings`` (m, 2) and ``landmarks`` (n, 2) in m; ``greedy`` and ``joint`` (m,) as in ``Association``,
    ``truth`` (m,) the right landmark, or below 0.
    """

    readings: Floats
    landmarks: Floats
    greedy: Ints
    joint: Ints
    truth: Ints

    @property
    def mistakes(self) -> int:
        """Readings that the greedy method gave to a wrong landmark."""
        return int(np.count_nonzero((self.greedy >= 0) & (self.greedy != self.truth)))


def example(drive: Drive) -> Example | None:
    """Drive with what is known, and the scan in which the greedy method would have erred most and the joint not."""
    best: Example | None = None

    def choose(_: int, candidates: Candidates, truth: Ints, origin: Ints) -> Association:
        nonlocal best
        found = by_truth(_, candidates, truth, origin)
        greedy, joint = (METHODS[name](candidates, GATES).landmark for name in ("greedy", "joint"))
        if found.matched.any() and not ((joint >= 0) & (joint != found.landmark)).any():
            h = candidates.readings.h
            one = Example(_as_points(h[0] + candidates.innovation[:, 0]), _as_points(h), greedy, joint, found.landmark)
            if one.mistakes > (best.mistakes if best else 0):
                best = one
        return found

    run(drive, choose)
    return best


def _as_points(polar: Floats) -> Floats:
    """Range and bearing (m, 2) as points of the body frame."""
    r, bearing = polar.T
    return np.stack([r * np.cos(bearing), r * np.sin(bearing)], axis=1)
