"""Observations that do not say what they are of: walked step by step, each associated before it is taken in.

A step's observations are held against the landmarks of the active sub-map, predicted to that step, and
against those of the sub-maps that closed lately: carried into its frame, they say which landmark it is
that a young sub-map sees again. That gives it an identity and nothing else, so no measurement counts twice.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from submaps.association.candidates import Readings, candidates
from submaps.association.methods import METHODS
from submaps.association.readings import predicted_readings
from submaps.association.result import AMBIGUOUS, NEW, Association, Gates
from submaps.config import MapConfig
from submaps.encounters import Columns, one_each
from submaps.filtering import kernel, layout
from submaps.filtering.ahead import look_ahead
from submaps.geometry.space import Space
from submaps.landmarks import LandmarkTable
from submaps.measurements import Floats, Ints, as_encounter
from submaps.observation.models import CARTESIAN, body_sensor
from submaps.robot import Robot
from submaps.submap import Submap

# What stands for a landmark's number where it is not known yet.
UNKNOWN = -1
# The status, beside the kernel's, of an observation that was not taken in.
AMBIGUOUS_STATUS = kernel.FIRST + 1
# Landmarks are carried through so many sub-maps that do not see them, and so many of them at most: farther on
# they are too unsure to tell from their neighbours.
CARRIED_SUBMAPS, MOST_CARRIED = 2, 100

Walked = tuple[Floats, NDArray[np.int32], NDArray[np.uint8], Floats]
Walk = Callable[[Robot, Columns], Walked]


@dataclass(frozen=True)
class Carried:
    """Landmarks ``numbers`` (q,) of sub-maps that have closed, in the frame of the active one.

    ``at`` (q, dim) m with the joint ``covariance`` (q dim, q dim) of their additive errors, independent of
    all that the active sub-map holds; ``age`` (q,) counts the sub-maps since one held them.
    """

    numbers: Ints
    at: Floats
    covariance: Floats
    age: Ints

    @classmethod
    def nothing(cls, dim: int) -> Carried:
        """That of a robot's first sub-map."""
        none = np.empty(0, dtype=np.int64)
        return cls(none, np.empty((0, dim)), np.empty((0, 0)), none)

    def only(self, which: NDArray[np.bool_]) -> Carried:
        """Some of them."""
        if which.all():
            return self
        rows = np.repeat(which, self.at.shape[1])
        return Carried(self.numbers[which], self.at[which], self.covariance[np.ix_(rows, rows)], self.age[which])

    def after(self, space: Space, n: int) -> tuple[Floats, Floats]:
        """Arrays for a state of n entries, still to be filled in, with these landmarks after it."""
        size = n + space.dim * self.numbers.size
        x, P = np.zeros(size), np.zeros((size, size))
        x[n:], P[n:, n:] = self.at.ravel(), self.covariance
        return x, P


@dataclass(frozen=True)
class Found:
    """What came of columns: as they were taken in, how they were walked, and what each observation is of.

    ``number`` (m,) is a landmark's; of an ambiguous observation the nearest one's.
    """

    columns: Columns
    walked: Walked
    number: Ints


class Associator:
    """Finds the landmarks of a map's observations; changed by one thread at a time."""

    def __init__(self, config: MapConfig, table: LandmarkTable, records: Sequence[Submap | None]) -> None:
        assert config.gate is not None  # a map that finds landmarks has both
        assert config.new_gate is not None
        self._method = METHODS[config.association]
        self._gates = Gates(config.gate, config.new_gate)
        self._invariant = config.filter == "invariant"
        self._space = config.geometry
        self._body = body_sensor(config.geometry)
        self._table = table
        self._records = records
        self._carried: dict[str, Carried] = {}

    def intern(self, names: tuple[str, ...]) -> tuple[Ints, list[tuple[str, float, int]]]:
        """Numbers of the names, ``UNKNOWN`` for those that are empty; new encounters as ``LandmarkTable.intern``."""
        named = [i for i, name in enumerate(names) if name]
        numbers = np.full(len(names), UNKNOWN, dtype=np.int64)
        numbers[named], met = self._table.intern(tuple(names[i] for i in named))
        return numbers, met

    def told(
        self, sent: tuple[str, ...], numbers: Ints, status: NDArray[np.uint8]
    ) -> tuple[tuple[str, ...], tuple[str | None, ...]]:
        """Each observation's name, and that of the landmark each one without a name was found to be of, if any."""
        names = tuple(self._table.names[i] for i in numbers.tolist())
        every = zip(sent, names, (status == AMBIGUOUS_STATUS).tolist(), strict=True)
        return names, tuple(None if ambiguous else name for given, name, ambiguous in every if not given)

    def walk(self, r: Robot, columns: Columns, walk: Walk) -> Found:
        """Walk columns of one robot, up to one step with observations after the other."""
        count = columns.landmark.shape[0]
        number, status = columns.landmark.copy(), np.full(count, AMBIGUOUS_STATUS, dtype=np.uint8)
        nis, taken = np.empty(count), np.ones(count, dtype=bool)
        tracks, chapters = [], []
        for part, first in _parts(columns):
            own = slice(first, first + part.landmark.shape[0])
            number[own], nis[own], taken[own] = self._identified(r, part)
            kept = first + np.flatnonzero(taken[own])
            before = r.active.number
            track, chapter, status[kept], nis[kept] = walk(r, replace(part, landmark=number[own]).only(taken[own]))
            tracks.append(track)
            chapters.append(chapter)
            self._carry(r, before)
        r.closed_counts[2] += np.count_nonzero(~taken)
        whole = replace(columns, landmark=number).only(taken)
        return Found(whole, (np.concatenate(tracks), np.concatenate(chapters), status, nis), number)

    def _identified(self, r: Robot, part: Columns) -> tuple[Ints, Floats, NDArray[np.bool_]]:
        """Each observation's number, its squared distance, and whether it is to be taken in."""
        number, taken = part.landmark.copy(), np.ones(part.landmark.shape[0], dtype=bool)
        squared = np.full(number.shape[0], math.nan)
        unknown = np.flatnonzero(number == UNKNOWN)
        if unknown.size:
            numbers, readings = self._expected(r, part)
            measured = candidates(readings, np.ascontiguousarray(part.z[:, unknown].T), part.each[unknown])
            found = self._method(measured, self._gates)
            number[unknown] = self._named(found, numbers)
            squared[unknown] = found.squared
            taken[unknown] = found.landmark != AMBIGUOUS
        return number, squared, taken

    def _named(self, found: Association, numbers: Ints) -> list[int]:
        """Numbers of what was found; a new landmark's name is a tilde and its number."""
        named = []
        for landmark, nearest in zip(found.landmark.tolist(), found.nearest.tolist(), strict=True):
            if landmark == NEW:
                fresh, _ = self._table.intern((f"~{len(self._table.names)}",))
                named.append(int(fresh[0]))
            else:
                named.append(int(numbers[nearest]))
        return named

    def _expected(self, r: Robot, part: Columns) -> tuple[Ints, Readings]:
        """Numbers (n,) of the landmarks at hand, and what they should read at the end of a part."""
        s, space = r.active, self._space
        self._table.lend_slots(s)
        carried = self._carried_by(r)
        carried = carried.only(self._table.slot_of[carried.numbers] < 0)
        x, P = carried.after(space, s.dimension)
        look_ahead(space.key, s.x, s.P, s.counts, s.motion, self._invariant, part.increments, part.noises, x, P)
        held, more = s.landmark_count, carried.numbers.size
        readings = predicted_readings(
            space, x, P, held + more, int(r.whole[layout.MODEL]), r.real[layout.SENSOR :], part.z.shape[0],
            self._invariant, more,
        )  # fmt: skip
        return self._of_landmarks(np.append(s.ids[:held], carried.numbers), readings)

    def _carried_by(self, r: Robot) -> Carried:
        return self._carried.get(r.name) or Carried.nothing(self._space.dim)

    def _of_landmarks(self, numbers: Ints, readings: Readings) -> tuple[Ints, Readings]:
        """Without the places where robots were seen, which no observation is of."""
        names = self._table.names
        real = np.array([as_encounter(names[i]) is None for i in numbers.tolist()], dtype=bool)
        if real.all():
            return numbers, readings
        h, H, entries = readings.h[real], readings.H[real], readings.entries[real]
        return numbers[real], replace(readings, h=h, H=H, entries=entries)

    def _carry(self, r: Robot, before: int) -> None:
        """Take landmarks along out of the sub-maps that have closed since, into the frame of the active one.

        Its origin is the last pose of the one before it: y = R^T (l - p), as a Cartesian sensor there would
        read it without noise, and their joint covariance is that of the readings.
        """
        while before != r.active.number:
            closed, space = self._records[before], self._space
            assert closed is not None  # the walk that closed it has filed it
            carried = self._carried_by(r)
            unseen = np.isin(carried.numbers, closed.landmarks, invert=True)
            carried = carried.only(unseen & (carried.age < CARRIED_SUBMAPS))
            n, held, more = closed.mean.shape[0], closed.landmarks.shape[0], carried.numbers.size
            x, P = carried.after(space, n)
            x[:n], P[:n, :n] = closed.mean, closed.covariance()
            readings = predicted_readings(
                space, x, P, held + more, CARTESIAN, self._body, space.dim, self._invariant, more
            )
            age = np.append(np.zeros(held, dtype=np.int64), carried.age + 1)
            every = np.append(closed.landmarks, carried.numbers).astype(np.int64)
            numbers, readings = self._of_landmarks(every, readings)
            age, numbers = age[np.isin(every, numbers)][:MOST_CARRIED], numbers[:MOST_CARRIED]
            size = space.dim * numbers.size
            covariance = readings.blocks(np.arange(numbers.size)).transpose(0, 2, 1, 3).reshape(size, size)
            self._carried[r.name] = Carried(numbers, readings.h[: numbers.size], covariance, age)
            before = closed.following


def _parts(columns: Columns) -> Iterator[tuple[Columns, int]]:
    """Columns up to and with each step that has observations, and the first observation of each."""
    count = columns.t.shape[0]
    ends = np.unique(columns.observation_step) + 1
    if not ends.size or ends[-1] < count:
        ends = np.append(ends, count)
    begin = 0
    for end in ends.tolist():
        first, last = np.searchsorted(columns.observation_step, [begin, end]).tolist()
        seen = slice(first, last)
        moved = slice(*np.searchsorted(columns.control_step, [begin, end]).tolist())
        part = Columns(
            t=columns.t[begin:end], control_step=columns.control_step[moved] - begin,
            increments=columns.increments[moved], noises=columns.noises[moved],
            observation_step=columns.observation_step[seen] - begin, landmark=columns.landmark[seen],
            z=np.ascontiguousarray(columns.z[:, seen]),
            R=columns.R if columns.R.shape[0] == 1 else one_each(columns.R[seen]), own=columns.own[seen],
        )  # fmt: skip
        yield part, first
        begin = end
