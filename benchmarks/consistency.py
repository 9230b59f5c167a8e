"""The circle world: does each way of estimating say how wrong it is?

Position and heading at the end of 1.1 laps over many runs: pose NEES per degree of freedom and
position RMSE, for sub-maps joined, one right-invariant map, and the textbook full-map EKF.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from submaps.atlas.estimates import PoseEstimate
from submaps.atlas.joining import join
from submaps.config import FilterName, MapConfig, MotionConfig, ObservationConfig
from submaps.consistency import average_bounds, nees
from submaps.mapper import Mapper
from submaps.simulation import Run, World, circle, drive

Floats = NDArray[np.float64]


def configure(world: World, filter: FilterName, one_map: bool) -> MapConfig:
    """The world's own noise; one map is a sub-map without bounds."""
    sigma = (world.observation_sigma, world.observation_sigma)
    config = MapConfig(MotionConfig("velocity", world.velocity_sigma), ObservationConfig("cartesian", sigma), filter)
    if one_map:
        return replace(config, max_landmarks=1000, max_heading_sigma=1e9, max_position_sigma=1e9)
    return config


def final_pose(config: MapConfig, run: Run) -> tuple[PoseEstimate, int]:
    """The robot's pose in ``map`` after the drive, all sub-maps joined; and how many there were."""
    mapper = Mapper(config)
    mapper.apply("robot", run.batch)
    mapper.install(join(mapper.problem()))
    view = mapper.view()
    return view.pose("robot"), view.submap_count


def errors(estimate: PoseEstimate, truth: Floats) -> tuple[float, float]:
    """NEES per degree of freedom of the pose, and the squared position error (m^2)."""
    e = np.array([estimate.x, estimate.y, estimate.theta]) - truth
    e[2] = math.remainder(e[2], 2.0 * math.pi)
    return nees(e, estimate.covariance) / 3.0, float(e[0] ** 2 + e[1] ** 2)


def study(runs: int, seed: int, progress: Callable[[str], None] = lambda _: None) -> dict[str, dict[str, float]]:
    """NEES per degree of freedom, RMSE (m) and sub-maps of each way, over the same runs."""
    world = circle()
    ways = {
        "sub-maps joined": configure(world, "invariant", False),
        "one right-invariant map": configure(world, "invariant", True),
        "one standard EKF": configure(world, "standard", True),
    }
    sums = {name: np.zeros(3) for name in ways}
    for i in range(runs):
        run = drive(world, np.random.default_rng([seed, i]))
        for name, config in ways.items():
            estimate, submaps = final_pose(config, run)
            sums[name] += (*errors(estimate, run.poses[-1]), submaps)
        progress(f"run {i + 1} of {runs}")
    return {
        name: {"nees": s[0] / runs, "rmse_m": math.sqrt(s[1] / runs), "submaps": s[2] / runs}
        for name, s in sums.items()
    }


def main() -> None:
    """Print the table and whether each figure is inside its limit."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    result = study(arguments.runs, arguments.seed)
    low, high = average_bounds(0.95, 3, arguments.runs)
    print(f"circle world, {arguments.runs} runs, seed {arguments.seed}; 95 % band of NEES [{low:.2f}, {high:.2f}]")
    for name, row in result.items():
        print(f"{name:26s} NEES/dof {row['nees']:7.2f}   RMSE {row['rmse_m']:.3f} m   sub-maps {row['submaps']:.0f}")
    joined, single = result["sub-maps joined"], result["one right-invariant map"]
    print(f"joined NEES inside [0.76, 1.27]: {0.76 <= joined['nees'] <= 1.27}")
    ratio = joined["rmse_m"] / single["rmse_m"]
    print(f"joined RMSE / one map RMSE = {ratio:.3f} (limit 0.95 .. 1.05): {abs(ratio - 1.0) <= 0.05}")


if __name__ == "__main__":
    main()
