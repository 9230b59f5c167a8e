"""The atlas as it stands at one moment: immutable, sharing all but the active sub-maps."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from submaps.config import MapConfig, Start
from submaps.errors import UnknownName
from submaps.geometry.space import Pose, Space
from submaps.submap import Submap

if TYPE_CHECKING:
    from submaps.atlas.solution import Solution

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class RobotState:
    """Where a robot is: in its active sub-map (``pose``), and by dead reckoning (``odom``).

    ``odom`` is ``None`` where there is no motion model to reckon by. ``channels`` is how many numbers
    each of its readings has. ``start`` is where its first pose lies, if its operator said so.
    """

    id: str
    number: int
    first: int
    submap: int
    t: float
    steps: int
    observations: int
    rejected: int
    pose: Pose
    odom: Pose | None
    odom_covariance: Floats
    start: Start | None = None
    channels: int = 2


@dataclass(frozen=True)
class AtlasState:
    """Closed sub-maps (shared, append-only lists), active ones as copied, robots, last solution.

    The shared lists may grow after this state was taken; the counts say how much of them is part
    of it. ``sightings[i]`` names the closed sub-maps that hold landmark i, in order of closing;
    ``settled`` is the graph's memory of what follows from closed sub-maps alone.
    """

    config: MapConfig
    records: list[Submap | None]
    submap_count: int
    active: dict[int, Submap]
    names: list[str]
    landmark_count: int
    number_of: dict[str, int]
    sightings: list[list[int]]
    robots: dict[str, RobotState]
    closed_bytes: int
    version: int
    solution: Solution | None = None
    encounter_count: int = 0
    settled: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def empty(cls, config: MapConfig) -> AtlasState:
        """The state of a map that has seen nothing."""
        return cls(config, [], 0, {}, [], 0, {}, [], {}, 0, 0)

    @property
    def space(self) -> Space:
        """The plane or space that the map is of."""
        return self.config.geometry

    def submap(self, number: int) -> Submap:
        """Sub-map ``number`` as of this state; raises ``UnknownName``."""
        if not 0 <= number < self.submap_count:
            raise UnknownName(f"submap {number}: the map has {self.submap_count}")
        found = self.active.get(number) or self.records[number]
        assert found is not None  # closed before the state was taken
        return found

    def submaps(self) -> Iterator[Submap]:
        """Every sub-map, by number."""
        return (self.submap(k) for k in range(self.submap_count))

    def chain(self, robot: int) -> list[Submap]:
        """A robot's sub-maps, from its first to its active one."""
        return self.members([robot])

    def members(self, robots: Collection[int]) -> list[Submap]:
        """The sub-maps of some robots, by number."""
        wanted = set(robots)
        return [s for s in self.submaps() if s.robot in wanted]

    @cached_property
    def fleet(self) -> list[RobotState]:
        """Every robot, by number."""
        return sorted(self.robots.values(), key=lambda r: r.number)

    @cached_property
    def roots(self) -> list[int]:
        """For each robot the lowest number among the robots of its component.

        Components are those of the last solve; a robot with a start belongs to that of its frame.
        """
        roots = list(range(len(self.fleet)))
        if self.solution is not None:
            roots[: len(self.solution.roots)] = self.solution.roots
        for robot in self.fleet:
            if robot.start is not None:
                k = submap_of(robot.start.frame)
                a, b = roots[0 if k is None else self.submap(k).robot], roots[robot.number]
                roots = [min(a, b) if root in (a, b) else root for root in roots]
        return roots

    @cached_property
    def _active_holders(self) -> dict[int, list[int]]:
        holders: dict[int, list[int]] = {}
        for k, submap in self.active.items():
            for landmark in submap.landmarks.tolist():
                holders.setdefault(landmark, []).append(k)
        return holders

    def submaps_with(self, landmark: int) -> list[int]:
        """Numbers of the sub-maps that hold a landmark, active ones included."""
        closed = [k for k in list(self.sightings[landmark]) if k < self.submap_count and k not in self.active]
        return sorted(closed + self._active_holders.get(landmark, []))

    def robot(self, name: str) -> RobotState:
        """A robot by name; raises ``UnknownName``."""
        if name not in self.robots:
            raise UnknownName(f"robot {name!r} has not sent anything to this map")
        return self.robots[name]

    def digest(self) -> bytes:
        """Digest of everything that a solve is computed from."""
        digest = hashlib.blake2b(digest_size=16)
        for submap in self.submaps():
            digest.update(submap.digest())
        if self.solution is not None:
            for array in self.solution.starting_point():
                digest.update(array.tobytes())
        for robot in self.fleet:
            if robot.start is not None:
                digest.update(repr((robot.number, robot.start)).encode())
        return digest.digest()


def submap_of(frame: str) -> int | None:
    """The number in ``submap/k``, ``None`` for ``map``; raises ``UnknownName``."""
    if frame == "map":
        return None
    match = re.fullmatch(r"submap/(\d{1,9})", frame)
    if match is None:
        raise UnknownName(f"frame {frame!r}: expected map, odom or submap/NUMBER")
    return int(match[1])
