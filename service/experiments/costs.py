"""Timed for ``scaling``: one filter of the kernel and of the references, and the map of the main path."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from service.experiments.base import Runs
from service.experiments.flatland import chunks
from submaps.config import MapConfig, MotionConfig, ObservationConfig
from submaps.mapper import Mapper
from submaps.measurements import Batch
from submaps.reference import ekf
from submaps.reference.compiled import Compiled, KernelFilter
from submaps.reference.ekf import Estimate
from submaps.reference.observation import Sighting
from submaps.reference.retraction import Standard
from submaps.simulation import World
from submaps.simulation import drive as drive_through

Floats = NDArray[np.float64]

SIZES = (50, 100, 200, 400, 800, 1600)
NAIVE_SIZES = (50, 100, 200, 400, 800)
PARTS = (4, 16)  # sub-maps that the N landmarks are split into
MAP_SIZES, CAPACITIES = (100, 400, 1600, 6400), (10, 25, 50)
SEEN, SEEN_AT = (1, 2, 4, 8, 16, 32), 200  # observations a step, with so many landmarks
# Landmarks of a filter between which its slope is taken: below, a call's fixed cost shows; above, where its
# covariance (80 MB at 1600) no longer fits a cache.
SLOPE_FROM, SLOPE_TO = 100, 800
_LEAST = 0.02  # s, that one round takes at least
_BATCH = 100  # steps
_OUT_OF_REACH = 1e9
_MODEL = Compiled(ObservationConfig("cartesian", (0.1, 0.1)))
_STEP, _NOISE = np.array([0.1, 0.0, 0.001]), np.diag([4e-4, 1e-4, 4e-6])


@dataclass
class Series:
    """Microseconds (or bytes) by number of landmarks, or of observations a step; ``order`` is the lecture's."""

    name: str
    order: str
    expected: float
    by: str
    parts: int = 1
    cost: dict[int, float] = field(default_factory=dict)
    over: tuple[float, float] = (0.0, math.inf)

    @property
    def slope(self) -> float:
        """d log(cost) / d log(N), least squares, where N is within ``over``."""
        low, high = self.over
        logs = np.log([(n, cost) for n, cost in self.cost.items() if low <= n <= high])
        return float(np.polyfit(logs[:, 0], logs[:, 1], 1)[0])


# -- one filter ----------------------------------------------------------------------------------


def seconds(work: Callable[[int], object], rounds: int) -> float:
    """Processor time of one of the ``work``'s repetitions: the best of so many rounds."""
    work(1)
    times, best = 1, math.inf
    while (spent := _timed(work, times)) < _LEAST:
        times = max(2 * times, math.ceil(1.2 * times * _LEAST / max(spent, 1e-6)))
    for _ in range(rounds):
        best = min(best, _timed(work, times) / times)
    return best


def _timed(work: Callable[[int], object], times: int) -> float:
    began = time.process_time()
    work(times)
    return time.process_time() - began


def one_map(landmarks: int) -> tuple[Estimate, Floats]:
    """A map with all its correlations, and what is read of each landmark."""
    rng = np.random.default_rng(landmarks)
    n = 3 + 2 * landmarks
    x = np.concatenate([np.zeros(3), rng.uniform(-0.5, 0.5, 2 * landmarks) * 5.0 * math.sqrt(landmarks)])
    root = 0.05 * rng.normal(size=(n, 8))
    P = root @ root.T
    P = 0.5 * (P + P.T)
    P[np.arange(n), np.arange(n)] += 0.01
    return Estimate(x, P), x[3:].reshape(-1, 2)


def predicting(landmarks: int, *, invariant: bool) -> Callable[[int], object]:
    """The compiled prediction."""
    estimate, _ = one_map(landmarks)
    kernel = KernelFilter(estimate, _MODEL, invariant=invariant, landmarks=0)
    return lambda times: kernel.predict(_STEP, _NOISE, times)


def updating(landmarks: int, seen: int = 1) -> Callable[[int], object]:
    """Compiled updates by ``seen`` landmarks, one after the other: O(N² M)."""
    estimate, readings = one_map(landmarks)
    kernel = KernelFilter(estimate, _MODEL, invariant=True, landmarks=0)

    def work(times: int) -> int:
        which = np.arange(times * seen) % landmarks
        return kernel.update(3 + 2 * which, np.ascontiguousarray(readings[which]), _MODEL.R)

    return work


def joint(landmarks: int, form: ekf.Form, seen: int = 1) -> Callable[[int], object]:
    """The reference's update by ``seen`` landmarks at once, P in the form given."""
    estimate, readings = one_map(landmarks)
    sightings = [Sighting(3 + 2 * i, readings[i], _MODEL.R, _MODEL) for i in range(seen)]

    def work(times: int) -> None:
        for _ in range(times):
            ekf.update(Standard(), estimate, sightings, form)

    return work


WORK: dict[str, Callable[[int, int], Callable[[int], object]]] = {
    "prediction, standard": lambda n, _: predicting(n, invariant=False),
    "prediction, right-invariant": lambda n, _: predicting(n, invariant=True),
    "update, compiled": updating,
    "update (I − WH) P": lambda n, seen: joint(n, ekf.naive, seen),
    "update P − W S Wᵀ": lambda n, seen: joint(n, ekf.subtracted, seen),
}


@dataclass(frozen=True)
class Task:
    """What one worker times: a work of ``WORK`` with so many landmarks and observations, in so many rounds."""

    work: str
    sizes: tuple[tuple[int, int], ...]
    rounds: int


def measure(task: Task) -> list[float]:
    """Microseconds of each size."""
    make = WORK[task.work]
    return [1e6 * seconds(make(landmarks, seen), task.rounds) for landmarks, seen in task.sizes]


def filters(runs: Runs) -> Iterator[Series]:
    """Each operation over the sizes of one filter, and of the sub-maps that share the landmarks out."""
    planned = [
        ("prediction, standard", "N", 1.0, SIZES, 1), ("prediction, right-invariant", "N²", 2.0, SIZES, 1),
        ("update, compiled", "N² M", 2.0, SIZES, 1), ("update (I − WH) P", "N³", 3.0, NAIVE_SIZES, 1),
    ]  # fmt: skip
    for t in PARTS:
        planned.append(("update, compiled", "(N/t)² M", 2.0, SIZES, t))
        planned.append(("update (I − WH) P", "(N/t)³", 3.0, NAIVE_SIZES, t))
    for work, order, expected, sizes, parts in planned:
        name = work if parts == 1 else f"{work}, t = {parts}"
        task = Task(work, tuple((n, 1) for n in sizes), runs.count)
        (cost,) = runs.each(measure, [task], name)
        found = dict(zip([n * parts for n in sizes], cost, strict=True))
        yield Series(name, order, expected, "landmarks", parts, found, (SLOPE_FROM * parts, SLOPE_TO * parts))


def seen_together(runs: Runs) -> Iterator[Series]:
    """Cost of a step against the number M of its observations."""
    for work, name in (("update, compiled", "compiled, one by one"), ("update P − W S Wᵀ", "P − W S Wᵀ, joint")):
        (cost,) = runs.each(measure, [Task(work, tuple((SEEN_AT, m) for m in SEEN), runs.count)], name)
        found = dict(zip(SEEN, cost, strict=True))
        yield Series(name, "N² M", 1.0, "observations a step", 1, found, (SEEN[2], math.inf))


# -- the map of the main path --------------------------------------------------------------------


def street(landmarks: int) -> World:
    """A street there and back, landmarks every 5 m on both sides, four or five of them in sight at each metre."""
    along = 5.0 * np.arange((landmarks + 1) // 2)
    points = np.concatenate([np.column_stack([along, np.full_like(along, side)]) for side in (-3.0, 3.0)])[:landmarks]
    metres = int(along[-1])
    leg = np.tile([10.0, 0.0], (metres, 1))
    velocity = np.concatenate([leg, [[0.0, 10.0 * math.pi]], leg])
    return World(points, velocity, 0.1, 6.5, 1, (0.05, 0.002), 0.1)


def maps(runs: Runs) -> Iterator[tuple[Series, Series]]:
    """Cost an observation on the way back, and bytes of the estimates, of maps whose sub-maps close at so many."""
    found = {n: runs.each(drives, [(n, runs.count)], f"a map of {n:,}")[0] for n in MAP_SIZES}
    for k, capacity in enumerate(CAPACITIES):
        name = f"sub-maps of {capacity}"
        cost, size = ({n: one[k][which] for n, one in found.items()} for which in (0, 1))
        yield Series(name, "1", 0.0, "landmarks", 1, cost), Series(name, "N", 1.0, "landmarks", 1, size)


def drives(task: tuple[int, int]) -> list[tuple[float, float]]:
    """Cost (µs) and bytes with so many landmarks, in so many rounds, for each of ``CAPACITIES``."""
    landmarks, rounds = task
    world = street(landmarks)
    batch = drive_through(world, np.random.default_rng(landmarks)).batch
    out = []
    for capacity in CAPACITIES:
        found = [_driven(world, batch, capacity) for _ in range(rounds)]
        out.append((min(one for one, _ in found), float(found[0][1])))
    return out


def _driven(world: World, batch: Batch, capacity: int) -> tuple[float, int]:
    """Microseconds an observation, of the median batch of the way back, and bytes at the end."""
    sigma = (world.observation_sigma, world.observation_sigma)
    config = MapConfig(
        MotionConfig("velocity", world.velocity_sigma), ObservationConfig("cartesian", sigma),
        max_landmarks=capacity, max_heading_sigma=_OUT_OF_REACH, max_position_sigma=_OUT_OF_REACH,
    )  # fmt: skip
    mapper, spent = Mapper(config), []
    for piece, _ in chunks(batch, _BATCH):
        began = time.process_time()
        mapper.apply("robot", piece)
        spent.append((time.process_time() - began) / piece.observations)
    return 1e6 * float(np.median(spent[len(spent) // 2 :])), mapper.view().counts()["bytes"]
