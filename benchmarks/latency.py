"""Tail latencies under solves and under load: ingest in a city against a street, poses while ingest runs.

city   One robot sends batches at a steady rate, from a straight street and from all streets of a city
       grid driven twice, each into a fresh service, in turn. The grid closes loops all the time, so
       its atlas is solved again and again. Limit: the grid's p99 at most twice the street's.
pose   Robots on maps of their own drive a street; their poses in `map` are asked for at a steady
       rate, with nothing else to do and then while all of them send batches as fast as answers
       come, in turn. Limit: the p99 under load at most five times the idle one.

Latencies count from a request's scheduled time, on the client's side of a loopback connection.
"""

from __future__ import annotations

import argparse
import statistics
import time

from rich.console import Console
from rich.table import Table

from benchmarks.common import verdict
from benchmarks.support.figures import PERCENTILES, Tally, together
from benchmarks.support.traffic import Outcome, Plan, Robot, Shape, fleet, measure, prepare
from benchmarks.support.worlds import Lap, grid, street
from service.client import Client
from service.standalone import own_service

CITY_LIMIT, POSE_LIMIT = 2.0, 5.0
_QUIET_SECONDS = 1.0
_MOST_STEPS_A_SECOND = 60_000  # prepared before: made while it runs, requests would stall the sender


def city(blocks: int, steps: int, rate: float, rounds: int, console: Console) -> None:
    """Ingest from a street and from a city, in turn."""
    town = grid(blocks)
    seconds = 2.0 * town.steps / (steps * rate)
    found: dict[str, list[Outcome]] = {"street": [], "grid": []}
    for _ in range(rounds):
        for lap in (street(), town):
            found[lap.name].append(driven(lap, Shape(steps), Plan(seconds, rate)))
    metres = 2 * town.steps
    console.print(f"{metres:,} m in batches of {steps} steps, {rate:g} batches/s for {seconds:.0f} s, {rounds} rounds")
    show({name: together([one.ingest for one in outcomes]) for name, outcomes in found.items()}, console)
    for name, outcomes in found.items():
        solves, took, cpu = (
            statistics.mean(one.rose.get(figure, float("nan")) for one in outcomes)
            for figure in ("submaps_solves_total", "submaps_solve_seconds_total", "process_cpu_seconds_total")
        )
        sizes = " and ".join(f"{one.rose['submaps']:.0f}" for one in outcomes)
        console.print(f"  {name}: {sizes} sub-maps, {solves:.0f} solves in {took:.1f} s, {cpu:.1f} s of processor time")
    p99 = {name: statistics.median(one.ingest.percentile(99) for one in outcomes) for name, outcomes in found.items()}
    print(verdict("ingest p99, city by street", p99["grid"] / p99["street"], CITY_LIMIT, "{:.2f} x".format))


def driven(lap: Lap, shape: Shape, plan: Plan) -> Outcome:
    """One robot's drive into a service of its own; ``rose`` holds the map's sub-maps too."""
    with own_service() as url:
        robots = fleet(url, lap, 1, 1, shape)
        prepare(robots, plan)
        done = measure(url, robots, plan)
        _check(done)
        done.rose["submaps"] = float(counts(url, robots[0].map)["submaps"])
    return done


def pose(robots: int, lap: Lap, steps: int, rate: float, seconds: float, rounds: int, console: Console) -> None:
    """Poses while nothing happens and while all robots send, in turn."""
    found: dict[str, list[Outcome]] = {"idle": [], "busy": []}
    with own_service() as url:
        fleet_ = fleet(url, lap, robots, robots, Shape(steps))
        measure(url, fleet_, Plan(2.0))
        for _ in range(rounds):
            for name, plan in (
                ("idle", Plan(seconds, queries=rate, warm_up=1.0, ingest=False)),
                ("busy", Plan(seconds, queries=rate, warm_up=1.0)),
            ):
                settle(url, fleet_)
                prepare(fleet_, Plan(plan.seconds + plan.warm_up, _MOST_STEPS_A_SECOND / steps))
                found[name].append(measure(url, fleet_, plan))
                _check(found[name][-1])
        submaps = sum(counts(url, robot.map)["submaps"] for robot in fleet_)
    console.print(f"poses of {robots} robots at {rate:g}/s, {rounds} rounds of {seconds:g} s", end="")
    console.print(f"; {submaps:,} sub-maps at the end")
    show({f"pose, {name}": together([one.queries for one in outcomes]) for name, outcomes in found.items()}, console)
    observations = statistics.median(one.observations / (seconds + 1.0) for one in found["busy"])
    console.print(f"  meanwhile {observations:,.0f} observations/s in batches of {steps} steps")
    p99 = {name: statistics.median(one.queries.percentile(99) for one in outcomes) for name, outcomes in found.items()}
    print(verdict("pose p99, busy by idle", p99["busy"] / p99["idle"], POSE_LIMIT, "{:.2f} x".format))


def counts(url: str, map_: str) -> dict[str, int]:
    """How much a map holds."""
    with Client(url) as client:
        found: dict[str, int] = client.request("GET", f"/v1/maps/{map_}")["counts"]
    return found


def settle(url: str, robots: list[Robot]) -> None:
    """Solve what is to be solved and ask for each pose once, so that nothing is left to do."""
    with Client(url) as client:
        for robot in robots:
            client.optimize(robot.map)
            client.request("GET", f"/v1/maps/{robot.map}/robots/{robot.name}/pose?frame=map")
    time.sleep(_QUIET_SECONDS)


def show(tallies: dict[str, Tally], console: Console) -> None:
    """A table of latencies."""
    table = Table()
    table.add_column("ms")
    for name in ("answers", *(f"p{p:g}" for p in PERCENTILES), "max"):
        table.add_column(name, justify="right")
    for name, tally in tallies.items():
        cells = [f"{tally.percentile(p) * 1e3:.2f}" for p in (*PERCENTILES, 100.0)]
        table.add_row(name, f"{tally.answered:,}", *cells)
    console.print(table)


def _check(done: Outcome) -> None:
    if done.ingest.errors or done.queries.errors:
        raise RuntimeError(f"refused: {done.ingest.errors} {done.queries.errors}")


def main() -> None:
    """Measure and say whether the limits hold."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.latency", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", nargs="?", choices=("city", "pose", "both"), default="both")
    parser.add_argument("--blocks", type=int, default=10, help="blocks of the city along a side (default: 10)")
    parser.add_argument("--rounds", type=int, default=3, help="rounds of both sides (default: 3)")
    parser.add_argument("--city-rate", type=float, default=200.0, help="batches/s (default: 200)")
    parser.add_argument("--city-steps", type=int, default=5, help="steps a batch, five observations each (default: 5)")
    parser.add_argument("--pose-world", choices=("grid", "street"), default="street", help="where (default: street)")
    parser.add_argument("--pose-rate", type=float, default=100.0, help="queries/s (default: 100)")
    parser.add_argument("--pose-steps", type=int, default=200, help="steps a batch under load (default: 200)")
    parser.add_argument("--pose-robots", type=int, default=4, help="robots, each on a map (default: 4)")
    parser.add_argument("--pose-seconds", type=float, default=8.0, help="length of a round of one side (default: 8)")
    options = parser.parse_args()
    console = Console(width=None if Console().is_terminal else 120, highlight=False)
    if options.what != "pose":
        city(options.blocks, options.city_steps, options.city_rate, options.rounds, console)
    if options.what != "city":
        lap = grid(options.blocks) if options.pose_world == "grid" else street()
        pose(
            options.pose_robots, lap, options.pose_steps, options.pose_rate, options.pose_seconds, options.rounds,
            console,
        )  # fmt: skip


if __name__ == "__main__":
    main()
