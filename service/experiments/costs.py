"""Timed for ``scaling``: one filter of the kernel and of the references, and the map of the main path."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

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


def filters(rounds: int) -> Iterator[Series]:
    """Each operation over the sizes of one filter, and of the sub-maps that share the landmarks out."""

    def series(
        name: str, order: str, expected: float, make: Callable[[int], Callable[[int], object]], sizes: tuple[int, ...],
        parts: int = 1,
    ) -> Series:  # fmt: skip
        found = Series(name, order, expected, "landmarks", parts, over=(SLOPE_FROM * parts, SLOPE_TO * parts))
        for n in sizes:
            found.cost[n * parts] = 1e6 * seconds(make(n), rounds)
        return found

    yield series("prediction, standard", "N", 1.0, lambda n: predicting(n, invariant=False), SIZES)
    yield series("prediction, right-invariant", "N²", 2.0, lambda n: predicting(n, invariant=True), SIZES)
    yield series("update, compiled", "N² M", 2.0, updating, SIZES)
    yield series("update (I − WH) P", "N³", 3.0, lambda n: joint(n, ekf.naive), NAIVE_SIZES)
    for parts in PARTS:
        yield series(f"update, compiled, t = {parts}", "(N/t)² M", 2.0, updating, SIZES, parts)
        yield series(
            f"update (I − WH) P, t = {parts}",
            "(N/t)³",
            3.0,
            lambda n: joint(n, ekf.naive),
            NAIVE_SIZES,
            parts,
        )


def seen_together(rounds: int) -> Iterator[Series]:
    """Cost of a step against the number M of its observations."""
    ways: dict[str, Callable[[int], Callable[[int], object]]] = {
        "compiled, one by one": lambda m: updating(SEEN_AT, m),
        "P − W S Wᵀ, joint": lambda m: joint(SEEN_AT, ekf.subtracted, m),
    }
    for name, make in ways.items():
        found = Series(name, "N² M", 1.0, "observations a step", over=(4, math.inf))
        for m in SEEN:
            found.cost[m] = 1e6 * seconds(make(m), rounds)
        yield found


# -- the map of the main path --------------------------------------------------------------------


def street(landmarks: int) -> World:
    """A street there and back, landmarks every 5 m on both sides, four or five of them in sight at each metre."""
    along = 5.0 * np.arange((landmarks + 1) // 2)
    points = np.concatenate([np.column_stack([along, np.full_like(along, side)]) for side in (-3.0, 3.0)])[:landmarks]
    metres = int(along[-1])
    leg = np.tile([10.0, 0.0], (metres, 1))
    velocity = np.concatenate([leg, [[0.0, 10.0 * math.pi]], leg])
    return World(points, velocity, 0.1, 6.5, 1, (0.05, 0.002), 0.1)


def maps(rounds: int) -> Iterator[tuple[Series, Series]]:
    """Cost an observation on the way back, and bytes of the estimates, of maps whose sub-maps close at so many."""
    drives = {n: (street(n), drive_through(street(n), np.random.default_rng(n)).batch) for n in MAP_SIZES}
    for capacity in CAPACITIES:
        cost = Series(f"sub-maps of {capacity}", "1", 0.0, "landmarks")
        size = Series(f"sub-maps of {capacity}", "N", 1.0, "landmarks")
        for n, (world, batch) in drives.items():
            found = [_driven(world, batch, capacity) for _ in range(rounds)]
            cost.cost[n], size.cost[n] = min(one for one, _ in found), float(found[0][1])
        yield cost, size


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
