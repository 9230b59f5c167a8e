"""A thousand robots on a thousand maps in one process: is each served, and what does it take.

Every robot sends a batch, waits for the answer, and sends the next, all at once and for a stated
time. Fair means that the robot served least got at least half of what the one served most got.
Memory is what the service's process holds, as its /metrics say.
"""

from __future__ import annotations

import argparse

from benchmarks.common import verdict
from benchmarks.support.figures import metrics
from benchmarks.support.traffic import Plan, Shape, fleet, measure, prepare
from benchmarks.support.worlds import park
from service.standalone import own_service

LIMIT = 2.0
_MIB = 2**20


def main() -> None:
    """Measure and say whether all were served alike."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.tenants", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--maps", type=int, default=1000, help="maps, with a robot each (default: 1000)")
    parser.add_argument("--steps", type=int, default=10, help="steps a batch, five observations each (default: 10)")
    parser.add_argument("--seconds", type=float, default=30.0, help="how long they send (default: 30)")
    options = parser.parse_args()
    with own_service() as url:
        held = [resident(url)]
        robots = fleet(url, park(500), options.maps, options.maps, Shape(options.steps))
        held.append(resident(url))
        first = measure(url, robots, Plan(0.001))  # every robot's first batch
        held.append(resident(url))
        plan = Plan(options.seconds)
        prepare(robots, plan, guess=2000.0)
        done = measure(url, robots, plan)
        held.append(resident(url))
    if first.ingest.errors or done.ingest.errors:
        raise RuntimeError(f"refused: {first.ingest.errors} {done.ingest.errors}")
    least, most, wait = min(done.by_robot), max(done.by_robot), max(done.longest)
    print(f"{options.maps} robots on {options.maps} maps, {options.steps} steps a batch, {options.seconds:g} s:")
    print(f"  {done.ingest.rate:,.0f} batches/s, {done.observations / options.seconds:,.0f} observations/s", end="")
    print(f", {done.each('submaps_journal_syncs_total'):.3f} syncs a batch", end="")
    print(f", {done.rose['submaps_solves_total']:.0f} solves")
    print(f"  batches acknowledged to a robot: {least} … {most}; wait p50 {done.ingest.percentile(50):.2f} s", end="")
    print(f", p99 {done.ingest.percentile(99):.2f} s, longest {wait:.2f} s")
    made, begun, at_end = ((later - held[0]) / options.maps / 1024 for later in held[1:])
    print(f"  memory: {held[0] / _MIB:.0f} MiB at the start; a map made {made:.1f} KiB, ", end="")
    print(f"with its first batch {begun:.1f} KiB, at the end {at_end:.1f} KiB")
    print(verdict("most served by least served", most / max(least, 1e-9), LIMIT, "{:.2f} x".format))


def resident(url: str) -> float:
    """Bytes that the service's process holds, nan where it does not say."""
    return metrics(url).get("process_resident_memory_bytes", float("nan"))


if __name__ == "__main__":
    main()
