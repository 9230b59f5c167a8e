"""Two robots that start 100 m apart and know nothing of each other: whether they become one map, and how honest it is.

They drive towards and past each other (``submaps.simulation.two_ways``), batches of 100 steps in turn,
solved whenever a solve is due. Errors are of the last poses in the frame of the first robot's first pose.
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray

from benchmarks.common import verdict
from service.datasets.dataset import cut
from submaps.atlas.joining import join
from submaps.config import MapConfig, MotionConfig, ObservationConfig
from submaps.consistency import average_bounds, nees
from submaps.geometry.se2 import between
from submaps.geometry.trig import wrap
from submaps.mapper import Mapper
from submaps.simulation import two_ways

CONFIG = MapConfig(MotionConfig("velocity", (0.05, np.deg2rad(1.0))), ObservationConfig("cartesian", (0.15, 0.15)))


def meet(seed: int) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]] | None:
    """Errors (3,) and covariances (3, 3) of both last poses, or ``None`` where the robots stay apart."""
    mapper = Mapper(CONFIG)
    runs = two_ways(np.random.default_rng(seed))
    steps = runs["east"].batch.steps
    for begin in range(0, steps, 100):
        for name, run in runs.items():
            mapper.apply(name, cut(run.batch, begin, min(begin + 100, steps)))
        if mapper.solve_due:
            mapper.install(join(mapper.problem()))
    mapper.install(join(mapper.problem()))
    view = mapper.view()
    if not view.connected(1):
        return None
    found = []
    for name, run in runs.items():
        pose = view.pose(name)
        true = between(tuple(runs["east"].poses[0]), tuple(run.poses[-1]))
        error = np.array([pose.x - true[0], pose.y - true[1], wrap(pose.theta - true[2])])
        found.append((error, pose.covariance))
    return found


def main() -> None:
    """Measure and say whether the limits hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=30, help="seeds from 0 on (default: 30)")
    runs = parser.parse_args().runs
    met = [one for one in map(meet, range(runs)) if one is not None]
    print(f"{len(met)} of {runs} runs end as one component")
    print(verdict("runs that stay apart", runs - len(met), 0))
    low, high = average_bounds(0.95, 3, len(met))
    for i, name in enumerate(("east", "west")):
        score = np.mean([nees(*one[i]) for one in met]) / 3.0
        inside = "holds" if low < score < high else "MISSED"
        print(f"{name}: NEES per degree of freedom {score:.3f} (95 % band {low:.2f} … {high:.2f}) {inside}")
        largest = max(float(np.max(np.abs(e) / np.sqrt(np.diag(P)))) for e, P in (one[i] for one in met))
        print(verdict(f"{name}: largest error by its sigma", largest, 3.0))


if __name__ == "__main__":
    main()
