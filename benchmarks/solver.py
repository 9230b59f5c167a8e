"""QDLDL against SciPy's SuperLU on the joined problem of a real file: analysis, factorisation, solve.

Also the sparse inverse subset beside a dense inverse, and how far the two solutions differ.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable

import numpy as np
from scipy.sparse import csc_array, triu
from scipy.sparse.linalg import splu

from benchmarks.common import DATA
from service.datasets.isam import read_isam
from submaps.atlas.component import Component
from submaps.atlas.joining import join
from submaps.atlas.sparse import Factorisation
from submaps.config import MapConfig
from submaps.mapper import Mapper


def best(way: Callable[[], object], rounds: int = 15) -> float:
    """Milliseconds of the fastest of some rounds."""
    shortest = math.inf
    for _ in range(rounds):
        begin = time.perf_counter()
        way()
        shortest = min(shortest, time.perf_counter() - begin)
    return shortest * 1e3


def measure(name: str) -> None:
    """Print the figures of one file."""
    run = read_isam(DATA / "isam" / name)
    mapper = Mapper(MapConfig(run.motion, run.observation))
    mapper.apply("robot", run.columns)
    component: Component = join(mapper.problem()).component(0)
    data = np.empty(component.pattern.indices.shape[0])
    gradient = np.empty(component.pattern.size)
    component.assemble(len(component.members), data, gradient)
    right = np.random.default_rng(0).normal(size=component.pattern.size)
    upper = csc_array(component.pattern.matrix(data))
    whole = csc_array(upper + triu(upper, 1).T)
    ours = Factorisation(component.pattern, data)
    theirs = splu(whole, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    difference = float(np.abs(ours.solve(right) - theirs.solve(right)).max())
    print(f"{name}: {component.pattern.size} unknowns, {upper.nnz} entries; solutions differ by {difference:.1e}")
    print(f"  QDLDL   first {best(lambda: Factorisation(component.pattern, data)):7.2f} ms", end="")
    print(f"  again {best(lambda: ours.update(data)):7.2f} ms  solve {best(lambda: ours.solve(right)):6.3f} ms")

    def again() -> object:
        return splu(whole, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})

    print(f"  SuperLU first {best(again):7.2f} ms  again (no reuse)     ", end="")
    print(f"solve {best(lambda: theirs.solve(right)):6.3f} ms")
    subset, dense = best(ours.inverse_subset), best(lambda: np.linalg.inv(whole.toarray()), 3)
    print(f"  inverse subset {subset:.2f} ms, dense inverse {dense:.2f} ms")


def main() -> None:
    """Both real problems."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    for name in ("victoriaPark.txt", "cityTrees10000.txt"):
        measure(name)


if __name__ == "__main__":
    main()
