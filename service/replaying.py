"""Replay a recorded run through a service over HTTP, and measure what comes out."""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from service.client import Client, path_of
from service.datasets import Dataset
from service.wire.poses import point_of
from submaps.alignment import Alignment, align
from submaps.batch import optimum
from submaps.fleet_batch import fleet_optimum

Progress = Callable[[int, int], None]
Points = Mapping[str, NDArray[np.float64]]


@dataclass(frozen=True)
class Part:
    """One robot's part in a replay; ``rejected`` counts observations by the reason given."""

    steps: int
    observations: int
    rejected: Mapping[str, int]
    connected: bool


@dataclass(frozen=True)
class Replayed:
    """What a replay did: counts of the map, wall-clock seconds, and the landmarks in ``map``."""

    map: str
    steps: int
    observations: int
    landmarks: int
    submaps: int
    ingest_seconds: float
    solve_seconds: float
    points: Points
    robots: Mapping[str, Part] = field(default_factory=dict)

    @property
    def microseconds_per_observation(self) -> float:
        """Of the whole way: HTTP, journal and estimate, the steps without observations included."""
        return 1e6 * self.ingest_seconds / max(self.observations, 1)

    @property
    def unconnected(self) -> list[str]:
        """The robots that no tie leads to from ``map``."""
        return [name for name, part in self.robots.items() if not part.connected]


def replay(client: Client, run: Dataset, map_: str, progress: Progress) -> Replayed:
    """Create the map, send every robot's batches in order, solve, and read the landmarks back.

    ``progress(done, total)`` counts steps. Raises what the client raises.
    """
    client.create_map(map_, run.config)
    done, ingest = 0, 0.0
    sequences: Counter[str] = Counter()
    rejected: dict[str, Counter[str]] = {robot: Counter() for robot in run.robots}
    for robot, batch in run.batches():
        sequences[robot] += 1
        began = time.perf_counter()
        answer = client.measure(map_, robot, sequences[robot], batch)
        ingest += time.perf_counter() - began
        rejected[robot].update(one["reason"] for one in answer["rejected"])
        done += batch.steps
        progress(done, run.steps)
    began = time.perf_counter()
    client.optimize(map_)
    solve = time.perf_counter() - began
    return _read_back(client, run, map_, rejected, ingest, solve)


def _read_back(
    client: Client, run: Dataset, map_: str, rejected: Mapping[str, Counter[str]], ingest: float, solve: float
) -> Replayed:
    counts = client.request("GET", path_of(map_))["counts"]
    connected = {one["id"]: bool(one["connected"]) for one in client.robots(map_)}
    return Replayed(
        map=map_,
        steps=counts["steps"],
        observations=counts["observations"],
        landmarks=counts["landmarks"],
        submaps=counts["submaps"],
        ingest_seconds=ingest,
        solve_seconds=solve,
        points={one["id"]: np.array(point_of(one)) for one in client.landmarks(map_)},
        robots={
            name: Part(batch.steps, batch.observations, dict(rejected[name]), connected[name])
            for name, batch in run.robots.items()
        },
    )


def has_batch(run: Dataset) -> bool:
    """Whether there is a batch optimum of the run: that of several robots, or with a gate, is of the plane alone."""
    return _is_plain(run) or run.observation.model in ("cartesian", "range_bearing")


def _is_plain(run: Dataset) -> bool:
    return len(run.robots) == 1 and run.config.gate is None


def batch_points(run: Dataset, progress: Progress) -> Points:
    """The landmarks of the batch optimum of a run, which is computed here.

    That of one robot without a gate is the plain one, over every pose.
    """
    if _is_plain(run):
        alone = optimum(run.columns, run.motion, run.observation, progress=progress)
        return dict(zip(alone.ids, alone.landmarks, strict=True))
    order = dict.fromkeys(robot for robot, _ in run.batches())  # `map` is the frame of the first one sent
    robots = {robot: run.robots[robot] for robot in order}
    fleet = fleet_optimum(robots, run.motion, run.observation, gate=run.config.gate, progress=progress)
    return dict(zip(fleet.ids, fleet.landmarks, strict=True))


def compare(points: Points, best: Points) -> Alignment | None:
    """The landmarks that both have, laid over one another; ``None`` where they are too few for that."""
    common = [name for name in best if name in points]
    if not common or len(common) < len(best[common[0]]):
        return None
    return align(*(np.array([of[name] for name in common]) for of in (points, best)))


def map_name(run: Dataset) -> str:
    """The name of a data set made into one that a map can have."""
    name = re.sub(r"[^a-z0-9_-]+", "-", run.name.lower()).strip("-_")
    return name[:64] or "run"
