"""Five robots on one map, a real run: landmarks and trajectories against Vicon, beside the batch optimum.

MRCLAM 7 goes through HTTP as the robots would send it, every two seconds a batch each, with a gate of
0.999. The robots begin at places unknown to one another. Errors are root mean squares: of the landmarks
after one rigid motion, of each trajectory after one of its own. The batch optimum is of the same
measurements, those within the same gate; unlike the filters it uses each of them at its best estimate.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from benchmarks.common import DATA, verdict
from service.client import Client
from service.datasets import Dataset, Truth, read_source
from service.evaluating import LONGEST_GAP, MapError, map_error
from service.replaying import Replayed, map_name, replay
from service.standalone import own_service
from submaps.alignment import align
from submaps.evaluation import absolute_error
from submaps.fleet_batch import FleetOptimum, fleet_optimum

LIMIT = 0.15


def through_http(run: Dataset, truth: Truth) -> tuple[Replayed, MapError]:
    with own_service() as url, Client(url) as client:
        done = replay(client, run, map_name(run), lambda *_: None)
        return done, map_error(client, done.map, truth)


def tell_of_service(run: Dataset, done: Replayed, found: MapError) -> None:
    print(f"{run.name}: {len(run.robots)} robots, {run.steps:,} steps, {run.observations:,} observations")
    for note, count in run.notes.items():
        print(f"  {note}: {count}")
    print(f"  {done.submaps:,} sub-maps, {done.ingest_seconds:.1f} s of ingest, last solve {done.solve_seconds:.1f} s")
    if done.unconnected:
        print(f"  NOT CONNECTED: {', '.join(done.unconnected)}")
    landmarks = found.landmarks
    print("  " + verdict(f"RMSE of {landmarks.statistics.count} landmarks (m)", landmarks.statistics.rmse, LIMIT))
    print(f"  largest {landmarks.statistics.max:.4f} m, NEES by 2n - 3 {landmarks.nees:.2f}", end="")
    print("" if found.pose_nees is None else f"; NEES of {found.poses} last poses by 3n {found.pose_nees:.2f}")


def tell_of_batch(best: FleetOptimum, truth: Truth) -> None:
    there = np.array([truth.landmarks[name] for name in best.ids])
    left_out = sum(int((~used).sum()) for used in best.used.values())
    print(f"  batch optimum: {align(best.landmarks, there).rmse:.4f} m, {left_out} observations left out", end="")
    print(f", chi-square {best.chi2:.0f}")


def tell_of_robots(run: Dataset, done: Replayed, found: MapError, best: FleetOptimum, truth: Truth) -> None:
    for robot, part in done.robots.items():
        said = f"  {robot}: {part.observations:,} observations"
        said += "".join(f", {count} {reason}" for reason, count in part.rejected.items())
        if robot in found.robots:
            said += f"; ATE {found.robots[robot].absolute.rmse:.4f} m"
        if robot in truth.trajectories:
            track = best.trajectories[robot]
            there, known = truth.trajectories[robot].at(track.t, LONGEST_GAP)
            said += f", batch {absolute_error(track.take(known), there.take(known)).rmse:.4f} m"
        print(said)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", nargs="?", type=Path, default=DATA / "mrclam_7", help="an MRCLAM folder")
    folder = parser.parse_args().folder
    if not folder.is_dir():
        print(f"no data set at {folder}; SUBMAPS_DATA names the folder of the data sets")
        return
    run = read_source(str(folder))
    if run.truth is None:
        print(f"{folder} holds no truth to compare with")
        return
    done, found = through_http(run, run.truth)
    best = fleet_optimum(run.robots, run.motion, run.observation, gate=run.config.gate)
    tell_of_service(run, done, found)
    tell_of_batch(best, run.truth)
    tell_of_robots(run, done, found, best, run.truth)


if __name__ == "__main__":
    main()
