"""Replay a recorded run through a service over HTTP, and measure what comes out."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from service.client import Client
from service.datasets import Dataset
from submaps.alignment import Alignment, align
from submaps.batch import optimum
from submaps.config import MapConfig

ROBOT = "robot"
Progress = Callable[[int, int], None]
Points = Mapping[str, NDArray[np.float64]]


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

    @property
    def microseconds_per_observation(self) -> float:
        """Of the whole way: HTTP, journal and estimate, the steps without observations included."""
        return 1e6 * self.ingest_seconds / max(self.observations, 1)


def replay(client: Client, run: Dataset, map_: str, progress: Progress) -> Replayed:
    """Create the map, send every batch in order, solve, and read the landmarks back.

    ``progress(done, total)`` counts steps. Raises what the client raises.
    """
    client.create_map(map_, MapConfig(run.motion, run.observation))
    done, ingest = 0, 0.0
    for sequence, batch in enumerate(run.batches(), start=1):
        began = time.perf_counter()
        client.measure(map_, ROBOT, sequence, batch)
        ingest += time.perf_counter() - began
        done += batch.steps
        progress(done, run.columns.steps)
    began = time.perf_counter()
    client.optimize(map_)
    solve = time.perf_counter() - began
    return _read_back(client, map_, ingest, solve)


def _read_back(client: Client, map_: str, ingest: float, solve: float) -> Replayed:
    path = f"/v1/maps/{quote(map_, safe='')}"
    counts = client.request("GET", path)["counts"]
    points = {
        one["id"]: np.array([one["x"], one["y"]]) for one in client.pages(f"{path}/landmarks", "landmarks", frame="map")
    }
    return Replayed(
        map=map_,
        steps=counts["steps"],
        observations=counts["observations"],
        landmarks=counts["landmarks"],
        submaps=counts["submaps"],
        ingest_seconds=ingest,
        solve_seconds=solve,
        points=points,
    )


def against_batch(run: Dataset, points: Points, progress: Progress) -> Alignment:
    """The landmarks against the batch optimum of the run, which is computed here."""
    best = optimum(run.columns, run.motion, run.observation, progress=progress)
    return align(np.array([points[name] for name in best.ids]), best.landmarks)


def map_name(run: Dataset) -> str:
    """The name of a data set made into one that a map can have."""
    name = re.sub(r"[^a-z0-9_-]+", "-", run.name.lower()).strip("-_")
    return name[:64] or "run"
