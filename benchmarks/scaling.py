"""How the cost of an observation grows with the map: the atlas, and one EKF for everything.

A vehicle drives the lanes of a park with one landmark a cell of 25 m², some five in sight wherever
it is, until the map holds 100, 1 000, ... of them. Then it drives on through what it knows, and the
processor time of ``Mapper.apply`` and ``Mapper.view`` is measured over windows of many batches, the
sizes in turn. Sub-maps close at so many landmarks; the bounds on heading and position are out of the
way. Beside it, one global EKF over as many landmarks: the same compiled update in O(N²), and the
textbook's (I - W H) P with dense matrices, O(N³), in NumPy.

Slopes are of least squares through (log N, log cost), over the sizes shown; that of the compiled EKF
passes 2 where its covariance outgrows a cache. Bytes are of the estimates after one lap, each lane
there and back. Solving is off the ingest path; --solve times it at each size.
"""

from __future__ import annotations

import argparse
import csv
import math
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.common import verdict
from benchmarks.support.one_filter import bytes_a_landmark, microseconds
from benchmarks.support.worlds import MOTION, OBSERVATION, Drive, park
from submaps.atlas.joining import join
from submaps.config import MapConfig
from submaps.mapper import Mapper

LIMIT = 1.2
_OUT_OF_THE_WAY = 1e6


@dataclass
class Series:
    """Cost an observation (µs) by number of landmarks, and bytes of the estimates a landmark."""

    name: str
    cost: dict[int, float]
    quartiles: dict[int, tuple[float, float]]
    bytes: dict[int, float]

    @property
    def slope(self) -> float:
        """d log(cost) / d log(N), least squares."""
        if len(self.cost) < 2:
            return math.nan
        logs = np.log([[n, cost] for n, cost in self.cost.items()])
        return float(np.polyfit(logs[:, 0], logs[:, 1], 1)[0])

    @property
    def span(self) -> str:
        """The range of sizes that the slope is taken over."""
        return f"{min(self.cost):,} … {max(self.cost):,}"


class Filling:
    """A map that holds all landmarks of a park, and the vehicle that drives on in it.

    ``bytes`` of the estimates, a landmark, are those after one lap: each lane there and back.
    """

    def __init__(self, landmarks: int, submap: int, steps: int) -> None:
        self.mapper = Mapper(
            MapConfig(
                MOTION, OBSERVATION, max_landmarks=submap,
                max_heading_sigma=_OUT_OF_THE_WAY, max_position_sigma=_OUT_OF_THE_WAY,
            )
        )  # fmt: skip
        self._steps = steps
        lap = park(landmarks)
        self._drive = Drive(lap)
        while self._drive.step < lap.steps:
            self.mapper.apply("robot", self._drive.next(steps))
        counts = self.mapper.view().counts()
        self.bytes = counts["bytes"] / counts["landmarks"]

    def window(self, batches: int) -> float:
        """Microseconds an observation over the next so many batches, of all threads' processor time."""
        following = [self._drive.next(self._steps) for _ in range(batches)]
        began = time.process_time()
        for batch in following:
            self.mapper.apply("robot", batch)
            self.mapper.view()
        seconds = time.process_time() - began
        return seconds / sum(batch.observations for batch in following) * 1e6


def atlas(sizes: list[int], submap: int, rounds: int, batches: int, steps: int) -> tuple[Series, dict[int, Filling]]:
    """The atlas's cost with sub-maps of so many landmarks, the sizes measured in turn."""
    maps = {n: Filling(n, submap, steps) for n in sizes}
    windows: dict[int, list[float]] = {n: [] for n in sizes}
    for k in range(rounds):
        for n in sizes if k % 2 == 0 else reversed(sizes):
            windows[n].append(maps[n].window(batches))
    series = Series(f"atlas, {submap} a sub-map", {}, {}, {})
    for n, filling in maps.items():
        low, middle, high = np.percentile(windows[n], (25, 50, 75)).tolist()
        series.cost[n], series.quartiles[n] = middle, (low, high)
        series.bytes[n] = filling.bytes
    return series, maps


def one_filter(sizes: list[int], *, naive: bool) -> Series:
    """The cost of one global EKF at each size."""
    cost = {n: microseconds(n, naive=naive) for n in sizes}
    name = "one EKF, naive O(N³)" if naive else "one EKF, compiled O(N²)"
    return Series(name, cost, {}, {n: bytes_a_landmark(n) for n in sizes})


# -- what is shown -------------------------------------------------------------------------------


def show(found: list[Series], console: Console) -> None:
    """Two tables: microseconds an observation, and bytes a landmark."""
    sizes = sorted({n for series in found for n in series.cost})
    for title, pick, form in (
        ("µs an observation, with so many landmarks in the map", "cost", "{:,.2f}"),
        ("bytes of the estimates a landmark", "bytes", "{:,.0f}"),
    ):
        table = Table(title=title, title_justify="left")
        table.add_column("")
        for n in sizes:
            table.add_column(f"{n:,}", justify="right")
        if pick == "cost":
            table.add_column("slope", justify="right")
            table.add_column("over", justify="right")
        for series in found:
            values = getattr(series, pick)
            cells = [form.format(values[n]) if n in values else "" for n in sizes]
            table.add_row(series.name, *cells, *([f"{series.slope:+.2f}", series.span] if pick == "cost" else []))
        console.print(table)


def write_csv(found: list[Series], path: Path) -> None:
    """One row for each series and size."""
    with path.open("w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(["series", "landmarks", "us_an_observation", "quartile_25", "quartile_75", "bytes_a_landmark"])
        for series in found:
            for n, cost in series.cost.items():
                writer.writerow([series.name, n, cost, *series.quartiles.get(n, ("", "")), series.bytes[n]])


def draw(found: list[Series], path: Path) -> None:
    """Cost and bytes against the number of landmarks, log-log."""
    from matplotlib.figure import Figure  # only here: an extra

    figure = Figure(figsize=(11.0, 4.8), dpi=150, layout="constrained")
    cost, size = figure.subplots(1, 2)
    for series in found:
        style = "o-" if series.quartiles else "s--"
        cost.loglog(list(series.cost), list(series.cost.values()), style, label=f"{series.name}: N^{series.slope:.2f}")
        size.loglog(list(series.bytes), list(series.bytes.values()), style, label=series.name)
    cost.set(xlabel="landmarks in the map", ylabel="µs an observation", title="Cost of an update")
    size.set(xlabel="landmarks in the map", ylabel="bytes a landmark", title="Memory of the estimates")
    for axes in (cost, size):
        axes.grid(True, which="major", alpha=0.3)
    cost.legend(fontsize=8)
    figure.savefig(path)


def solves(maps: dict[int, Filling], submap: int, console: Console) -> None:
    """Time one solve of each map from nothing."""
    for n, filling in maps.items():
        problem = filling.mapper.problem()
        began = time.process_time()
        solution = join(problem)
        seconds = time.process_time() - began
        console.print(
            f"  a solve from nothing, {n:,} landmarks, {submap} a sub-map: {seconds:.2f} s, "
            f"{problem.submap_count:,} sub-maps, {solution.iterations} iterations"
        )


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.scaling", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--landmarks", type=int, nargs="+", default=[100, 1_000, 10_000, 100_000], metavar="N",
        help="landmarks in the map (default: 100 1000 10000 100000)",
    )  # fmt: skip
    parser.add_argument(
        "--submaps", type=int, nargs="+", default=[10, 25, 50], metavar="N",
        help="landmarks at which a sub-map closes (default: 10 25 50)",
    )  # fmt: skip
    parser.add_argument(
        "--one-filter", type=int, nargs="*", default=[100, 300, 1_000, 3_000], metavar="N",
        help="sizes of the global EKF, compiled; 3 000 need 600 MB (default: 100 300 1000 3000; none: leave it out)",
    )  # fmt: skip
    parser.add_argument(
        "--naive", type=int, nargs="*", default=[100, 300, 1_000], metavar="N",
        help="sizes of the naive global EKF (default: 100 300 1000; none: leave it out)",
    )  # fmt: skip
    parser.add_argument("--rounds", type=int, default=60, help="windows measured at each size (default: 60)")
    parser.add_argument("--batches", type=int, default=10, help="batches a window (default: 10)")
    parser.add_argument("--steps", type=int, default=100, help="steps a batch, five observations each (default: 100)")
    parser.add_argument(
        "--solve", type=int, default=0, metavar="N",
        help="time a solve from nothing too, of maps of up to so many landmarks (10 000 take minutes)",
    )  # fmt: skip
    parser.add_argument("--csv", type=Path, metavar="FILE", help="write the figures")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw them (needs the extra plot)")
    options = parser.parse_args()
    for name in ("landmarks", "submaps", "one_filter", "naive"):
        values = getattr(options, name)
        if any(n < 1 for n in values):
            parser.error(f"--{name.replace('_', '-')}: got {min(values)}, expected numbers above 0")
        setattr(options, name, sorted(set(values)))
    if options.landmarks[0] < 20 or options.submaps[-1] > 1000:
        parser.error("--landmarks: expected 20 or more; --submaps: expected 1 to 1000")
    return options


def main() -> None:
    """Measure, show, and say whether the atlas's cost is flat."""
    options = _options()
    console = Console(width=None if Console().is_terminal else 120)
    found: list[Series] = []
    for submap in options.submaps:
        series, maps = atlas(options.landmarks, submap, options.rounds, options.batches, options.steps)
        found.append(series)
        solves({n: one for n, one in maps.items() if n <= options.solve}, submap, console)
    if options.one_filter:
        found.append(one_filter(options.one_filter, naive=False))
    if options.naive:
        found.append(one_filter(options.naive, naive=True))
    show(found, console)
    low, high = options.landmarks[0], options.landmarks[-1]
    for series in found[: len(options.submaps)]:
        name = f"{series.name}: cost at {high:,} landmarks against {low:,}"
        print(verdict(name, series.cost[high] / series.cost[low], LIMIT, "{:.2f} x".format))
    if options.csv:
        write_csv(found, options.csv)
    if options.plot:
        draw(found, options.plot)


if __name__ == "__main__":
    main()
