"""The compiled update at 50 landmarks against a compiled in-place scaling of the same covariance.

In the plane with Cartesian readings, in space with stereo ones. Both run inside compiled loops, in turn, and
the best of many rounds counts. The scaling reads and writes the covariance once, whole rows as the filter
keeps them: the least that an update could do.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from benchmarks.common import verdict
from submaps._jit import jit
from submaps.config import Camera, ObservationConfig
from submaps.filtering.kernel import update
from submaps.filtering.predicting import predict_invariant
from submaps.filtering.workspace import workspace
from submaps.geometry.space import PLANE, SOLID, Key, Space
from submaps.observation.models import MODELS, reading, sensor_of
from submaps.submap import ActiveSubmap

Floats = NDArray[np.float64]

SENSORS = {
    PLANE: ObservationConfig("cartesian", (0.2, 0.2)),
    SOLID: ObservationConfig(
        "stereo", (1.0, 1.0, 1.0, 1.0), (0.0, 0.0, 0.0, -0.5, 0.5, -0.5, 0.5), Camera(500.0, 500.0, 320.0, 240.0, 0.25)
    ),
}
# With its prediction, only the plane has a limit: in space the covariance's three rank-one terms are dearer.
LIMITS = {PLANE: (2.0, 3.5), SOLID: (2.0, None)}


@jit("void(float64[:, ::1], int64, int64)")
def _scale(P: Floats, n: int, times: int) -> None:
    width = (n + 7) // 8 * 8
    for k in range(times):
        by = 1.0 + 1e-9 if k % 2 else 1.0 - 1e-9
        for i in range(n):
            for j in range(width):
                P[i, j] *= by


@jit()
def _update(
    space: Key, x: Floats, P: Floats, n: int, z: Floats, model: int, sensor: Floats, R: Floats, noise: Floats,
    scratch: Floats, predicted: bool, times: int,
) -> None:  # fmt: skip
    dim, pose = len(space), 3 * len(space) - 3
    w, wide = workspace(), z.shape[1]
    readings = z.reshape(z.size)
    U, A = scratch[: pose - dim], scratch[pose - dim : pose]
    step = np.zeros(pose)
    for k in range(times):
        has_u = False
        if predicted:
            step[0] = 0.1 if k % 2 else -0.1
            has_u = predict_invariant(space, x, P, n, step, noise, U)
        i = k % z.shape[0]
        update(
            space, x, P, n, pose + dim * i, model, sensor, 0, readings, wide * i, R, math.inf, math.inf, True, U, has_u,
            A, False, w, w,
        )  # fmt: skip


def prepare(space: Space, landmarks: int) -> tuple[ActiveSubmap, Floats]:
    """A sub-map with a dense covariance, and readings of its landmarks that fit it."""
    rng = np.random.default_rng(1)
    submap = ActiveSubmap(0, 0, 0.0, landmarks, space)
    n = space.pose + space.dim * landmarks
    points = rng.uniform(-5.0, 5.0, (landmarks, space.dim))
    points[:, 0] += 15.0
    submap.x[space.pose : n] = points.ravel()
    root = rng.normal(size=(n, n)) * 0.1 / math.sqrt(landmarks)
    submap.P[:n, :n] = root @ root.T
    submap.P[:n, :n] = np.tril(submap.P[:n, :n]) + np.tril(submap.P[:n, :n], -1).T
    config = SENSORS[space]
    sensor = sensor_of(space, config)
    return submap, np.stack([reading(space.key, MODELS[config.model], sensor, y)[0] for y in points])


def measure(space: Space, landmarks: int, rounds: int, times: int) -> dict[str, float]:
    """Microseconds of one scaling, one update, and one update with its prediction."""
    n, config = space.pose + space.dim * landmarks, SENSORS[space]
    sensor, R = sensor_of(space, config), np.diag(np.square(config.sigma))
    noise = np.diag([1e-4, *[4e-6] * (space.pose - 1)])
    best = dict.fromkeys(("scaling", "update", "update with prediction"), math.inf)
    for _ in range(rounds):
        s, z = prepare(space, landmarks)
        ours = partial(_update, space.key, s.x, s.P, n, z, MODELS[config.model], sensor, R, noise, s.scratch)
        ways: dict[str, Callable[[], None]] = {
            "scaling": partial(_scale, s.P, n, times),
            "update": partial(ours, False, times),
            "update with prediction": partial(ours, True, times),
        }
        for name, way in ways.items():
            begin = time.perf_counter()
            way()
            best[name] = min(best[name], (time.perf_counter() - begin) / times * 1e6)
    return best


def main() -> None:
    """Print microseconds and ratios."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--landmarks", type=int, default=50)
    parser.add_argument("--rounds", type=int, default=300)
    parser.add_argument("--times", type=int, default=200)
    arguments = parser.parse_args()
    for space in (PLANE, SOLID):
        best = measure(space, arguments.landmarks, arguments.rounds, arguments.times)
        for name, microseconds in best.items():
            print(f"{space.name} {name:24s} {microseconds:7.2f} µs at {arguments.landmarks} landmarks")
        for name, limit in zip(("update", "update with prediction"), LIMITS[space], strict=True):
            ratio = best[name] / best["scaling"]
            told = f"{space.name} {name} / scaling"
            print(f"{told}: {ratio:.2f}" if limit is None else verdict(told, ratio, limit))


if __name__ == "__main__":
    main()
