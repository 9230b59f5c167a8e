"""What a closed sub-map takes in memory, against its packed covariance and means.

A park is driven twice with sub-maps of so many landmarks, solved, and asked for everything: poses,
landmarks, sub-maps, edges. Then each closed sub-map is weighed: whatever it alone keeps alive
(itself, its arrays, what it remembers between queries) and its entries in the lists that say which
sub-maps hold a landmark. Beside it, what the last solution and the graph remember a sub-map.
"""

from __future__ import annotations

import argparse
import gc
import sys
import tracemalloc
from dataclasses import replace
from types import FunctionType, ModuleType

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.common import verdict
from benchmarks.support.worlds import MOTION, OBSERVATION, Drive, park
from submaps.atlas.joining import join
from submaps.atlas.state import AtlasState
from submaps.atlas.view import View
from submaps.config import MapConfig
from submaps.mapper import Mapper
from submaps.submap import Submap

LIMIT = 1.2
_SHARED = (type, ModuleType, FunctionType, str)  # str: names of attributes


def driven(landmarks: int, submap: int) -> AtlasState:
    """A park driven twice."""
    mapper = Mapper(MapConfig(MOTION, OBSERVATION, max_landmarks=submap, max_heading_sigma=1e6, max_position_sigma=1e6))
    lap = park(landmarks)
    drive = Drive(lap)
    while drive.step < 2 * lap.steps:
        mapper.apply("robot", drive.next(100))
    return mapper.problem()


def ask_everything(view: View) -> None:
    """Every kind of query over the whole map."""
    for frame in ("map", "odom", "submap/0"):
        view.pose("robot", frame)
    view.landmarks(0, view.state.landmark_count)
    list(view.submaps())
    for number in range(view.submap_count):
        view.local_landmarks(number)
    view.edges()
    view.counts()


def weigh(submap: Submap) -> int:
    """Bytes of a sub-map and of all that is reached from it."""
    seen: set[int] = set()
    todo: list[object] = [submap]
    total = 0
    while todo:
        one = todo.pop()
        if id(one) in seen or isinstance(one, _SHARED):
            continue
        seen.add(id(one))
        total += sys.getsizeof(one)
        if isinstance(one, np.ndarray) and one.base is not None:
            todo.append(one.base)
        todo += gc.get_referents(one)
    return total


def entries(state: AtlasState) -> float:
    """Bytes that a sub-map's landmarks take in the lists of who holds them, a landmark."""
    empty = sys.getsizeof([])
    held = sum(len(one) for one in state.sightings)
    return sum(sys.getsizeof(one) - empty for one in state.sightings) / held


def measure(landmarks: int, submap: int) -> dict[str, float]:
    """Bytes a closed sub-map: packed, in all, and what solution and graph remember."""
    state = driven(landmarks, submap)
    tracemalloc.start()
    solution = join(state)
    view = View(replace(state, solution=solution, version=1))
    ask_everything(view)
    gc.collect()
    with_all = tracemalloc.get_traced_memory()[0]
    del view, solution
    gc.collect()
    without_solution = tracemalloc.get_traced_memory()[0]
    state.settled.clear()
    gc.collect()
    without_graph = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    closed = [one for one in state.records if one is not None]
    share = entries(state)
    packed = sum(one.packed.nbytes + one.mean.nbytes for one in closed)
    whole = sum(weigh(one) + share * one.landmarks.shape[0] for one in closed)
    count = len(closed)
    return {
        "sub-maps": count,
        "landmarks each": sum(one.landmarks.shape[0] for one in closed) / count,
        "packed": packed / count,
        "in all": whole / count,
        "graph": (without_solution - without_graph) / count,
        "solution": (with_all - without_solution) / count,
    }


def main() -> None:
    """Weigh, show, and say whether the limit holds."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.memory", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--landmarks", type=int, default=500, help="landmarks of the park (default: 500)")
    parser.add_argument("--submaps", type=int, nargs="+", default=[10, 25, 50], metavar="N", help="sizes of a sub-map")
    options = parser.parse_args()
    found = {submap: measure(options.landmarks, submap) for submap in options.submaps}
    table = Table(title="bytes a closed sub-map", title_justify="left")
    names = list(next(iter(found.values())))
    for name in ("closes at", *names):
        table.add_column(name, justify="right")
    for submap, figures in found.items():
        table.add_row(str(submap), *(f"{figures[name]:,.0f}" for name in names))
    Console(width=None if Console().is_terminal else 120).print(table)
    for submap, figures in found.items():
        name = f"memory by packed covariance and means, {submap} landmarks"
        print(verdict(name, figures["in all"] / figures["packed"], LIMIT, "{:.2f} x".format))


if __name__ == "__main__":
    main()
