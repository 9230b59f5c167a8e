"""Recorded runs with their ids dropped: how many sightings find the landmark that the file says they are of.

A landmark of the map stands for the one whose sighting began it. A sighting of another that lies closer
than half a metre counts as right: the city's trees have twins a centimetre apart. Places that were left
long ago are not recognised yet, so no loop is closed, and a tree that is seen again later is begun again;
beside it, what known ids give if they are forgotten in the same way.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks.accuracy import sources
from benchmarks.common import batch_landmarks
from service.datasets import Dataset, read_source
from submaps.alignment import align
from submaps.association.methods import METHODS
from submaps.atlas.joining import join
from submaps.config import MapConfig
from submaps.mapper import Mapper
from submaps.measurements import Floats

TWINS = 0.5  # m
LATELY = 100  # steps


def found(run: Dataset, config: MapConfig) -> tuple[Mapper, list[str | None], float]:
    """The map of a run without ids, the landmark of each sighting, and the processor time it took."""
    names: list[str | None] = []
    mapper, began = Mapper(config), time.process_time()
    for robot, batch in run.batches():
        report = mapper.apply(robot, replace(batch, landmark=("",) * batch.observations))
        names += report.found or ()
    return mapper, names, time.process_time() - began


def forgetful(run: Dataset) -> list[str]:
    """The file's ids, each changed when it has not been seen lately."""
    last: dict[str, tuple[int, str]] = {}
    names: list[str] = []
    for step, true in zip(run.columns.observation_step.tolist(), run.columns.landmark, strict=True):
        before, name = last.get(true, (-LATELY - 1, ""))
        last[true] = (step, name if step - before <= LATELY else f"{true}/{len(names)}")
        names.append(last[true][1])
    return names


def rmse(mapper: Mapper, origin: dict[str, str], optimum: dict[str, Floats]) -> float:
    """Root mean square distance (m) of the map's landmarks to the batch optimum's, aligned, all sub-maps joined."""
    mapper.install(join(mapper.problem()))
    view = mapper.view()
    at = [view.landmark(name, "map") for name in origin]
    return align(np.array([[one.x, one.y] for one in at]), np.array([optimum[true] for true in origin.values()])).rmse


def verdicts(
    run: Dataset, names: Sequence[str | None], optimum: dict[str, Floats]
) -> tuple[dict[str, int], dict[str, str]]:
    """What became of the sightings, and the tree that each landmark stands for."""
    counts = dict.fromkeys(("right", "wrong", "begun", "aside", "lately", "lately the same"), 0)
    origin: dict[str, str] = {}
    last: dict[str, tuple[int, str]] = {}
    for step, true, name in zip(run.columns.observation_step.tolist(), run.columns.landmark, names, strict=True):
        before, as_then = last.get(true, (-LATELY - 1, ""))
        lately = step - before <= LATELY
        counts["lately"] += lately
        counts["lately the same"] += lately and name == as_then
        if name is None:
            counts["aside"] += 1
            continue
        last[true] = (step, name)
        if name not in origin:
            origin[name] = true
            counts["begun"] += 1
        else:
            near = np.hypot(*(optimum[origin[name]] - optimum[true])) < TWINS
            counts["right" if near else "wrong"] += 1
    return counts, origin


def study(run: Dataset) -> None:
    """Print one run's table."""
    optimum = batch_landmarks(run)
    print(f"{run.name}: {run.observations} sightings of {len(optimum)} landmarks, ids dropped")
    for method in METHODS:
        mapper, names, seconds = found(run, MapConfig(run.motion, run.observation, association=method))  # type: ignore[arg-type]
        counts, origin = verdicts(run, names, optimum)
        told = ", ".join(f"{name} {count}" for name, count in counts.items())
        each = seconds / np.unique(run.columns.observation_step).size * 1e6
        print(f"  {method:10s} {told}; {each:.0f} µs a step with sightings, {mapper.view().submap_count} sub-maps")
        print(f"             landmark RMSE to the batch optimum, aligned: {rmse(mapper, origin, optimum):.1f} m")
    names_ = forgetful(run)
    known = Mapper(MapConfig(run.motion, run.observation))
    known.apply("robot", replace(run.columns, landmark=tuple(names_)))
    origin = dict(zip(names_, run.columns.landmark, strict=True))
    error = rmse(known, origin, optimum)
    print(f"  known ids, forgotten after {LATELY} steps: {len(origin)} landmarks, RMSE {error:.1f} m")


def main() -> None:
    argparse.ArgumentParser(description=__doc__).parse_args()
    for source in sources():
        study(read_source(source))


if __name__ == "__main__":
    main()
