"""Put a Submaps service under load: many robots over HTTP, at a stated rate or as fast as answers come.

Robots drive a simulated world and send their batches, each over a connection of its own; queries for
their poses in `map` may run beside. At a rate the loop is open: a request's latency counts from when
it was due, so a service that falls behind shows it. Without --url a service is started for the run.
It stops by itself after --seconds.
"""

from __future__ import annotations

import argparse
import math
import secrets
import sys
from contextlib import ExitStack
from typing import Any

import orjson
from rich.console import Console
from rich.table import Table

from benchmarks.support.figures import PERCENTILES
from benchmarks.support.http import is_loopback
from benchmarks.support.traffic import Outcome, Plan, Shape, fleet, measure, prepare
from benchmarks.support.worlds import WORLDS
from service.client import Refused, Unreachable
from service.standalone import own_service

_MOST_SECONDS = 3600.0


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.load", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--url", help="address of a running service (default: start one)")
    add("--allow-remote", action="store_true", help="let --url name another machine")
    add("--robots", type=int, default=32, help="robots, a connection each (default: 32)")
    add("--maps", type=int, help="maps, the robots dealt out to them in turn (default: one a robot)")
    add("--rate", type=float, default=0.0, help="batches/s of all robots; 0: as fast as answers come (default: 0)")
    add("--seconds", type=float, default=10.0, help="how long is counted (default: 10)")
    add("--warm-up", type=float, default=1.0, help="seconds before, not counted (default: 1)")
    add("--steps", type=int, default=10, help="steps a batch (default: 10)")
    add("--observations", type=int, help="most observations a step (default: all in sight, some five)")
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument("--columns", action="store_true", help="send columns, which is the default")
    kind.add_argument("--rows", action="store_true", help="send rows")
    add("--world", choices=sorted(WORLDS), default="park", help="where they drive (default: park)")
    add("--queries", type=float, default=0.0, help="poses asked for a second; 0: none (default: 0)")
    add("--seed", type=int, default=0, help="of the noise (default: 0)")
    add("--json", action="store_true", help="print the result as JSON")
    options = parser.parse_args()
    options.maps = options.robots if options.maps is None else options.maps
    _check(parser, options)
    return options


def _check(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    for name in ("robots", "maps", "steps"):
        if getattr(options, name) < 1:
            parser.error(f"--{name}: got {getattr(options, name)}, expected 1 or more")
    if options.observations is not None and options.observations < 0:
        parser.error(f"--observations: got {options.observations}, expected 0 or more")
    for name in ("rate", "warm_up", "queries"):
        if not 0.0 <= getattr(options, name) < math.inf:
            parser.error(f"--{name.replace('_', '-')}: got {getattr(options, name)}, expected 0 or more")
    if not 0.0 < options.seconds <= _MOST_SECONDS:
        parser.error(f"--seconds: got {options.seconds}, expected more than 0 and at most {_MOST_SECONDS:.0f}")
    if options.maps > options.robots:
        parser.error(f"--maps: got {options.maps}, expected at most one for each of {options.robots} robots")
    if options.url and not options.allow_remote and not is_loopback(options.url):
        parser.error(f"--url: {options.url} is not on this machine; --allow-remote lets it be")


def load(url: str, options: argparse.Namespace) -> Outcome:
    """Make the maps, prepare the requests, send them."""
    shape = Shape(options.steps, options.observations, options.rows)
    name = f"load-{secrets.token_hex(3)}"  # a service that runs on may have been loaded before
    robots = fleet(url, WORLDS[options.world](), options.robots, options.maps, shape, name=name, seed=options.seed)
    plan = Plan(options.seconds, options.rate, options.queries or None, options.warm_up)
    prepare(robots, plan)
    return measure(url.rstrip("/"), robots, plan)


def result(options: argparse.Namespace, done: Outcome) -> dict[str, Any]:
    """All figures of a load, to be printed or read by a program."""
    seconds = options.seconds + options.warm_up
    return {
        "load": {name: value for name, value in vars(options).items() if name not in ("json", "columns")},
        "ingest": done.ingest.figures(),
        "queries": done.queries.figures() if options.queries else None,
        "observations_per_second": done.observations / seconds,
        "syncs_per_batch": done.each("submaps_journal_syncs_total"),
        "solves": done.rose.get("submaps_solves_total"),
        "solve_seconds": done.rose.get("submaps_solve_seconds_total"),
        "service_cpu_seconds": done.rose.get("process_cpu_seconds_total"),
        "load_cpu_seconds": done.cpu_seconds,
        "batches_of_a_robot": {"least": min(done.by_robot), "most": max(done.by_robot)},
    }


def show(figures: dict[str, Any], console: Console) -> None:
    """The result as two tables."""
    table = Table()
    for k, name in enumerate(("ms", "answers", "a second", *(f"p{p:g}" for p in PERCENTILES), "max", "errors")):
        table.add_column(name, justify="right" if k else "left")
    for kind in ("ingest", "queries"):
        if (one := figures[kind]) is not None:
            named = [one[f"p{p:g}_ms"] for p in PERCENTILES] + [one["max_ms"]]
            errors = ", ".join(f"{n} × {status}" for status, n in sorted(one["errors"].items())) or "none"
            table.add_row(kind, f"{one['answered']:,}", f"{one['rate']:,.1f}", *(f"{ms:.2f}" for ms in named), errors)
    console.print(table)
    beside = {
        "observations/s": f"{figures['observations_per_second']:,.0f}",
        "syncs a batch": f"{figures['syncs_per_batch']:.3f}",
        "solves": _shown(figures["solves"], "{:.0f}") + _shown(figures["solve_seconds"], ", {:.1f} s"),
        "processor time of the service": _shown(figures["service_cpu_seconds"], "{:.1f} s"),
        "processor time of this load": f"{figures['load_cpu_seconds']:.1f} s",
        "batches of a robot": "{least} … {most}".format(**figures["batches_of_a_robot"]),
    }
    for name, value in beside.items():
        console.print(f"  {name}: {value}")


def _shown(value: float | None, form: str) -> str:
    return "not told" if value is None else form.format(value)


def main() -> None:
    """Load, and show what came of it; exit code 1 where a batch was refused or a query failed."""
    options = _options()
    try:
        with ExitStack() as stack:
            url = options.url or stack.enter_context(own_service())
            done = load(url, options)
    except (Unreachable, Refused) as error:
        sys.exit(f"{error}")
    figures = result(options, done)
    if options.json:
        print(orjson.dumps(figures, option=orjson.OPT_INDENT_2).decode())
    else:
        show(figures, Console(width=None if Console().is_terminal else 120, highlight=False))
    # A pose that no tie connects to `map` yet is an answer (409), not a failure of the service.
    if done.ingest.errors or set(done.queries.errors) - {"409"}:
        sys.exit(1)


if __name__ == "__main__":
    main()
