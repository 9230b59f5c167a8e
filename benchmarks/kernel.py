"""The compiled update at 50 landmarks against a compiled in-place scaling of the same covariance.

Both run inside compiled loops, in turn, and the best of many rounds counts. The scaling reads and
writes the covariance once, whole rows as the filter keeps them: the least that an update could do.
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
from submaps.filtering.kernel import predict_invariant, update
from submaps.submap import ActiveSubmap

Floats = NDArray[np.float64]


@jit("void(float64[:, ::1], int64, int64)")
def _scale(P: Floats, n: int, times: int) -> None:
    width = (n + 7) // 8 * 8
    for k in range(times):
        by = 1.0 + 1e-9 if k % 2 else 1.0 - 1e-9
        for i in range(n):
            for j in range(width):
                P[i, j] *= by


@jit("void(float64[::1], float64[:, ::1], int64, float64[:, ::1], float64[:, ::1], boolean, int64)")
def _update(x: Floats, P: Floats, n: int, z: Floats, scratch: Floats, predicted: bool, times: int) -> None:
    u, a, b = scratch[0], scratch[1], scratch[2]
    mount = np.array([0.0, 0.0, 1.0, 0.0])
    R = np.array([[0.04, 0.0], [0.0, 0.04]])
    noise = np.diag(np.array([1e-4, 4e-6, 4e-6]))
    step = np.zeros(3)
    for k in range(times):
        has_u = False
        if predicted:
            step[0] = 0.1 if k % 2 else -0.1
            has_u = predict_invariant(x, P, n, step, noise, u)
        landmark = k % z.shape[0]
        update(
            x, P, n, 3 + 2 * landmark, 0, mount, z[landmark, 0], z[landmark, 1], R, math.inf, math.inf, True,
            u, has_u, a, b,
        )  # fmt: skip


def prepare(landmarks: int) -> tuple[ActiveSubmap, Floats]:
    """A sub-map with a dense covariance, and readings of its landmarks that fit it."""
    rng = np.random.default_rng(1)
    submap = ActiveSubmap(0, 0, 0.0, landmarks)
    n = 3 + 2 * landmarks
    submap.x[3:n] = rng.normal(size=2 * landmarks) * 20.0
    root = rng.normal(size=(n, n)) * 0.1
    submap.P[:n, :n] = root @ root.T
    submap.P[:n, :n] = np.tril(submap.P[:n, :n]) + np.tril(submap.P[:n, :n], -1).T
    return submap, submap.x[3:n].reshape(-1, 2).copy()


def measure(landmarks: int, rounds: int, times: int) -> dict[str, float]:
    """Microseconds of one scaling, one update, and one update with its prediction."""
    n = 3 + 2 * landmarks
    best = dict.fromkeys(("scaling", "update", "update with prediction"), math.inf)
    for _ in range(rounds):
        submap, z = prepare(landmarks)
        ways: dict[str, Callable[[], None]] = {
            "scaling": partial(_scale, submap.P, n, times),
            "update": partial(_update, submap.x, submap.P, n, z, submap.scratch, False, times),
            "update with prediction": partial(_update, submap.x, submap.P, n, z, submap.scratch, True, times),
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
    best = measure(arguments.landmarks, arguments.rounds, arguments.times)
    for name, microseconds in best.items():
        print(f"{name:24s} {microseconds:7.2f} µs at {arguments.landmarks} landmarks")
    print(verdict("update / scaling", best["update"] / best["scaling"], 2.0))
    print(verdict("update with prediction / scaling", best["update with prediction"] / best["scaling"], 3.5))


if __name__ == "__main__":
    main()
