"""The landmarks of a map: their numbers, who saw them, and where they lie in the sub-map at work."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps.measurements import Ints, as_encounter
from submaps.submap import ActiveSubmap, Submap


class LandmarkTable:
    """What a mapper keeps of each landmark, by its number: first sightings count from 0.

    ``names``, ``number_of`` and ``sightings`` (the closed sub-maps that hold it) are shared with the
    atlas and only grow; ``slot_of`` (landmarks,) is its place in the state of the sub-map at work, or -1.
    """

    def __init__(self, names: list[str], number_of: dict[str, int], sightings: list[list[int]]) -> None:
        self.names = names
        self.number_of = number_of
        self.sightings = sightings
        self.encounters = 0
        self.slot_of, self._last_seen, self._seen_first = np.full((3, 16), -1, dtype=np.int32)
        self._lent_to: ActiveSubmap | None = None

    def intern(self, names: tuple[str, ...]) -> tuple[Ints, list[tuple[str, float, int]]]:
        """Numbers of the names, new names the next ones; new encounters (robot, t, number)."""
        number_of = self.number_of
        try:
            return np.array([number_of[name] for name in names], dtype=np.int64), []
        except KeyError:
            new = dict.fromkeys(name for name in names if name not in number_of)
        met = []
        for name in new:
            encounter = as_encounter(name)
            if encounter is not None:
                met.append((*encounter, len(number_of)))
            self.names.append(name)
            self.sightings.append([])
            number_of[name] = len(number_of)
        self.encounters += len(met)
        room = self.slot_of.shape[0]
        if len(number_of) > room:
            more = np.full(max(room, len(number_of) - room), -1, dtype=np.int32)
            self.slot_of = np.concatenate([self.slot_of, more])
            self._last_seen = np.concatenate([self._last_seen, more])
            self._seen_first = np.concatenate([self._seen_first, more])
        return np.array([number_of[name] for name in names], dtype=np.int64), met

    def lend_slots(self, submap: ActiveSubmap) -> None:
        """Make ``slot_of`` speak of this sub-map."""
        last = self._lent_to
        if last is submap:
            return
        if last is not None:
            self.slot_of[last.ids[: last.landmark_count]] = -1
        held = submap.landmark_count
        pose, dim = submap.space.pose, submap.space.dim
        self.slot_of[submap.ids[:held]] = pose + dim * np.arange(held, dtype=np.int32)
        self._lent_to = submap

    def file(self, closed: Submap) -> bool:
        """Note what a sub-map holds that has closed; whether it ties to others than its neighbour."""
        held = closed.landmarks.tolist()
        for landmark in held:
            self.sightings[landmark].append(closed.number)
        seen = self._last_seen[held].tolist()
        self._last_seen[held] = closed.number
        return any(k not in (-1, closed.previous) for k in seen)

    def all_seen_by(self, robot: int) -> None:
        """Say that the map's only robot so far saw all of them."""
        self._seen_first[: len(self.names)] = robot

    def foreign(self, landmark: Ints, robot: int, roots: NDArray[np.int64]) -> list[int]:
        """Those of a robot's landmarks that a robot of another component saw first; ``roots`` by robot."""
        first = self._seen_first[landmark]
        self._seen_first[landmark[first < 0]] = robot
        found: list[int] = landmark[(first >= 0) & (roots[first] != roots[robot])].tolist()
        return found
