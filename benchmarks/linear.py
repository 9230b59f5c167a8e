"""A linear world (headings known): sub-maps joined against one linear least-squares batch.

Nothing is approximated here, so what is left is what joining loses: nothing but rounding.
"""

from __future__ import annotations

import argparse
import math
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from benchmarks.common import verdict
from submaps.atlas.joining import join
from submaps.config import FilterName, MapConfig, MotionConfig, ObservationConfig
from submaps.mapper import Mapper
from submaps.measurements import Batch

Floats = NDArray[np.float64]
MOTION_SIGMA, OBSERVATION_SIGMA, RANGE = (0.05, 0.03), 0.1, 4.5
LANDMARKS = np.array([[2, -2], [6, -2], [10, 2], [10, 6], [6, 10], [2, 10], [-2, 6], [-2, 2]], dtype=float)


def _turn(theta: float) -> Floats:
    c, s = math.cos(theta), math.sin(theta)
    return np.array([[c, -s], [s, c]])


def drive(seed: int = 5, steps: int = 64) -> Batch:
    """Two rounds of a square past eight landmarks; only positions and sightings are noisy."""
    rng = np.random.default_rng(seed)
    position, heading = np.zeros(2), 0.0
    controls, seen_at, names, readings = [], [], [], []
    for k in range(steps):
        if k:
            turn = 0.5 * math.pi if k % 8 == 0 else 0.0
            controls.append((1.0 + MOTION_SIGMA[0] * rng.normal(), MOTION_SIGMA[1] * rng.normal(), turn))
            position, heading = position + _turn(heading) @ (1.0, 0.0), heading + turn
        for i, landmark in enumerate(LANDMARKS):
            if np.hypot(*(landmark - position)) < RANGE:
                seen_at.append(k)
                names.append(str(i))
                readings.append(_turn(heading).T @ (landmark - position) + OBSERVATION_SIGMA * rng.normal(size=2))
    return Batch(
        t=np.arange(steps, dtype=np.float64),
        control_step=np.arange(1, steps),
        control=np.ascontiguousarray(np.array(controls).T),
        control_covariance=None,
        observation_step=np.array(seen_at),
        landmark=tuple(names),
        z=np.ascontiguousarray(np.array(readings).T),
        observation_covariance=None,
    )


def batch(run: Batch) -> tuple[Floats, Floats]:
    """Linear least squares over all positions (n, 2) and landmarks (m, 2), the first position fixed."""
    count = run.steps
    heading = np.concatenate([[0.0], np.cumsum(run.control[2])])
    rows = [(2 * k, 2 * k - 2, heading[k - 1], run.control[:2, k - 1], MOTION_SIGMA) for k in range(1, count)]
    for o in range(run.observations):
        k, i = int(run.observation_step[o]), int(run.landmark[o])
        rows.append((2 * count + 2 * i, 2 * k, heading[k], run.z[:, o], (OBSERVATION_SIGMA, OBSERVATION_SIGMA)))
    A, right = np.zeros((2 * len(rows), 2 * count + 2 * len(LANDMARKS))), np.zeros(2 * len(rows))
    for at, (to, origin, theta, value, sigma) in enumerate(rows):
        whitened = _turn(theta).T / np.array(sigma)[:, np.newaxis]
        A[2 * at : 2 * at + 2, to : to + 2] = whitened
        A[2 * at : 2 * at + 2, origin : origin + 2] = -whitened
        right[2 * at : 2 * at + 2] = value / np.array(sigma)
    values = np.concatenate([np.zeros(2), np.linalg.lstsq(A[:, 2:], right, rcond=None)[0]])
    return values[: 2 * count].reshape(-1, 2), values[2 * count :].reshape(-1, 2)


def difference(filter: FilterName) -> tuple[float, int]:
    """The most (m) by which a joined frame or landmark is off the batch, and the number of sub-maps."""
    run = drive()
    sigma = (OBSERVATION_SIGMA, OBSERVATION_SIGMA)
    config = MapConfig(
        MotionConfig("odometry", (*MOTION_SIGMA, 0.0)), ObservationConfig("cartesian", sigma), filter, max_landmarks=4
    )
    mapper = Mapper(config)
    track = mapper.apply("robot", run).track_submap
    begins = np.flatnonzero(np.diff(track)) + 1
    mapper.install(join(mapper.problem()))
    view = mapper.view()
    positions, landmarks = batch(run)
    found = [view.landmark(str(i)) for i in range(len(LANDMARKS))]
    frames = np.array([view.frame_in(int(track[k]), "map")[:2] for k in begins])
    worst = max(
        np.abs(np.array([(e.x, e.y) for e in found]) - landmarks).max(), np.abs(frames - positions[begins]).max()
    )
    return float(worst), view.submap_count


def main() -> None:
    """Print the difference for each filter."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    for filter in get_args(FilterName):
        worst, submaps = difference(filter)
        print(verdict(f"{filter}, {submaps} sub-maps: joined against batch (m)", worst, 1e-9))


if __name__ == "__main__":
    main()
