"""Requests of one step from many robots at once, durable, against a route that only reads the body.

Both are processes of their own on this machine, with the same server, event loop and framework; the
same client sends the same bodies as fast as answers come, each robot waiting for its answer. They are
measured in turn, in many short rounds, and the median ratio counts. --rows sends rows, not columns.
"""

from __future__ import annotations

import argparse
import statistics

from benchmarks.common import verdict
from benchmarks.support.reader import reader
from benchmarks.support.traffic import Plan, Shape, fleet, measure, prepare
from benchmarks.support.worlds import park
from service.standalone import own_service

LIMIT = 3.0
_WARM_UP = 0.3


def main() -> None:
    """Measure and say whether the limit holds."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.onestep", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--robots", type=int, default=32, help="robots at once (default: 32)")
    parser.add_argument("--maps", type=int, default=32, help="maps that they are on (default: 32, one each)")
    parser.add_argument("--rounds", type=int, default=7, help="rounds of both (default: 7)")
    parser.add_argument("--seconds", type=float, default=3.0, help="length of a round of one of them (default: 3)")
    parser.add_argument("--rows", action="store_true", help="send rows instead of columns")
    parser.add_argument("--base", choices=("fastapi", "starlette"), default="fastapi", help="framework of the reader")
    options = parser.parse_args()
    shape = Shape(1, None, options.rows)
    ours, bases = [], []
    with reader(options.base) as base_url, own_service() as url:
        robots = fleet(url, park(), options.robots, options.maps, shape)
        plan = Plan(options.seconds, warm_up=_WARM_UP)
        for k in range(-1, options.rounds):  # the first warms both up
            prepare(robots, plan)
            base = measure(base_url, [robot.repeater() for robot in robots], plan)
            own = measure(url, robots, plan)
            if base.ingest.errors or own.ingest.errors:
                raise RuntimeError(f"refused: {base.ingest.errors or own.ingest.errors}")
            if k >= 0:
                bases.append(base)
                ours.append(own)
    kind = "rows" if options.rows else "columns"
    print(f"{options.robots} robots on {options.maps} maps, one step a request, {kind}:")
    for name, rounds in (("the service", ours), (f"the reader, {options.base}", bases)):
        rate = statistics.median(one.ingest.rate for one in rounds)
        p99 = statistics.median(one.ingest.percentile(99) for one in rounds) * 1e3
        cpu = statistics.median(one.each("process_cpu_seconds_total") for one in rounds) * 1e6
        print(f"  {name}: {rate:,.0f} requests/s, p99 {p99:.1f} ms, {cpu:.0f} µs of processor time a request")
    syncs = statistics.median(one.each("submaps_journal_syncs_total") for one in ours)
    print(f"  {syncs:.3f} syncs a request")
    ratio = statistics.median(base.ingest.rate / own.ingest.rate for base, own in zip(bases, ours, strict=True))
    print(verdict("the reader's rate by the service's", ratio, LIMIT, "{:.2f} x".format))


if __name__ == "__main__":
    main()
