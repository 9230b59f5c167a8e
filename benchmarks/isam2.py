"""Sub-maps against gtsam's ISAM2 from Python: the same file, the same noise, all CPU time counted.

ISAM2 gets one update a pose, as its users do: build the pose's factors, begin the pose from the
last estimate and a landmark from its first observation, ``update``. Reading the whole map after
each update (``calculateEstimate``) is not counted, nor done. The Python package has no Cartesian
factor, so an observation goes in as bearing and range with the covariance turned, as ``load2D``
of gtsam does it, the bearing's sigma being sigma / range.

Sub-maps get the same columns in batches of 1 000 observations through ``Mapper.apply``, a ``join``
whenever one is due, and one at the end. Both sides are judged by their landmarks against the batch
optimum of the file, rigidly aligned. CPU time is ``time.process_time``: all threads of the process.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Mapping
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from benchmarks.common import batch_landmarks, verdict
from service.datasets import VICTORIA_PARK, Dataset, read_source
from submaps.alignment import align
from submaps.atlas.joining import join
from submaps.config import MapConfig
from submaps.mapper import Mapper

Landmarks = Mapping[str, NDArray[np.float64]]


@dataclass(frozen=True)
class Cost:
    """CPU seconds of a run, and where it left the landmarks."""

    updates: float
    everything: float
    landmarks: Landmarks


def isam2(run: Dataset, params: gtsam.ISAM2Params) -> Cost:
    """One update a pose; ``updates`` is the time inside ``update`` alone."""
    columns = run.columns
    motion_noise = gtsam.noiseModel.Diagonal.Sigmas(np.array(run.motion.sigma))
    origin_noise = gtsam.noiseModel.Diagonal.Sigmas(np.full(3, 1e-6))
    sigma = run.observation.sigma[0]
    first = np.searchsorted(columns.observation_step, np.arange(columns.steps + 1))
    numbers: dict[str, int] = {}
    updating = 0.0
    began = time.process_time()
    solver = gtsam.ISAM2(params)
    for k in range(columns.steps):
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        if k == 0:
            pose = gtsam.Pose2(0.0, 0.0, 0.0)
            graph.add(gtsam.PriorFactorPose2(0, pose, origin_noise))
        else:
            moved = gtsam.Pose2(*columns.control[:, k - 1])
            pose = solver.calculateEstimatePose2(k - 1).compose(moved)
            graph.add(gtsam.BetweenFactorPose2(k - 1, k, moved, motion_noise))
        values.insert(k, pose)
        for i in range(first[k], first[k + 1]):
            number = numbers.setdefault(columns.landmark[i], len(numbers))
            key, point = gtsam.symbol("l", number), columns.z[:, i]
            reach = float(np.hypot(*point))
            noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([sigma / reach, sigma]))
            bearing = gtsam.Rot2(float(np.arctan2(point[1], point[0])))
            graph.add(gtsam.BearingRangeFactor2D(k, key, bearing, reach, noise))
            if not values.exists(key) and not solver.valueExists(key):
                values.insert(key, pose.transformFrom(point))
        before = time.process_time()
        solver.update(graph, values)
        updating += time.process_time() - before
    everything = time.process_time() - began
    estimate = solver.calculateBestEstimate()
    landmarks = {name: estimate.atPoint2(gtsam.symbol("l", n)) for name, n in numbers.items()}
    return Cost(updating, everything, landmarks)


def sub_maps(run: Dataset, max_observations: int = 1000) -> Cost:
    """Default settings; ``updates`` is the time in ``apply``, ``everything`` adds every solve."""
    batches = [batch for _, batch in run.batches(max_observations)]
    mapper = Mapper(MapConfig(run.motion, run.observation))
    updates = solves = 0.0
    for batch in batches:
        before = time.process_time()
        mapper.apply("car", batch)
        after = time.process_time()
        updates += after - before
        if mapper.solve_due:
            mapper.install(join(mapper.problem()))
            solves += time.process_time() - after
    before = time.process_time()
    mapper.install(join(mapper.problem()))
    solves += time.process_time() - before
    view = mapper.view()
    at = {name: view.landmark(name, "map") for name in view.landmark_ids()}
    return Cost(updates, updates + solves, {name: np.array([at[name].x, at[name].y]) for name in at})


def rmse(found: Landmarks, optimum: Landmarks) -> float:
    names = list(optimum)
    return align(np.array([found[n] for n in names]), np.array([optimum[n] for n in names])).rmse


def params_of(skip: int | None, threshold: float | None) -> gtsam.ISAM2Params:
    params = gtsam.ISAM2Params()
    if skip is not None:
        params.relinearizeSkip = skip
    if threshold is not None:
        params.setRelinearizeThreshold(threshold)
    return params


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("source", nargs="?", default=VICTORIA_PARK, help="data set (default: %(default)s)")
    parser.add_argument("--relinearize-skip", type=int, help="ISAM2's relinearizeSkip (default: gtsam's own, 10)")
    parser.add_argument("--relinearize-threshold", type=float, help="ISAM2's threshold (default: gtsam's own, 0.1)")
    parser.add_argument("--repeats", type=int, default=5, help="runs of ours, of which the median counts")
    options = parser.parse_args()
    run = read_source(options.source)
    optimum = batch_landmarks(run)
    observations = run.columns.observations
    print(f"{run.name}: {run.columns.steps} poses, {observations} observations, {len(optimum)} landmarks")

    sub_maps(run)  # the first run touches code and memory that the others find ready
    ours = [sub_maps(run) for _ in range(options.repeats)]
    updates = statistics.median(cost.updates for cost in ours)
    everything = statistics.median(cost.everything for cost in ours)
    print(f"sub-maps: updates {updates:.4f} s, with every solve {everything:.4f} s ", end="")
    print(f"(median of {len(ours)}), landmark RMSE {rmse(ours[0].landmarks, optimum):.4f} m")

    theirs = isam2(run, params_of(options.relinearize_skip, options.relinearize_threshold))
    print(f"ISAM2: update() {theirs.updates:.1f} s, with building and begin values {theirs.everything:.1f} s, ", end="")
    print(f"landmark RMSE {rmse(theirs.landmarks, optimum):.4f} m")

    share = "1/{:.0f}".format
    for name, base in (("update() alone", theirs.updates), ("all that a user's loop does", theirs.everything)):
        print(f"against {name} of ISAM2:")
        print("  " + verdict("updates", updates / base, 1 / 200, lambda v: share(1 / v)))
        print("  " + verdict("updates and every solve", everything / base, 1 / 20, lambda v: share(1 / v)))


if __name__ == "__main__":
    main()
