"""Durable ingest through HTTP against the same batches applied in process.

Column batches of 1 000 observations, into one new map after another: by one client that waits for
each acknowledgement, then by several at once, each with maps of its own. Two loads: a hall of fifty
landmarks, ten in view, which fills a sub-map to the size that the kernel's budget is stated for;
and Victoria Park, with seven landmarks to a sub-map and two steps to an observation, where the
filter has so little to do that JSON, HTTP and the sync dominate.

Rates are observations by wall-clock time. The bodies are encoded beforehand; the service is a
process of its own, on the same machine, and solves each map's atlas meanwhile as it does for
anyone. In process, ``Mapper.apply`` takes the same decoded batches, and nothing is solved.
"""

from __future__ import annotations

import argparse
import http.client
import re
import statistics
import time
from concurrent.futures import ThreadPoolExecutor
from urllib.parse import urlsplit

import httpx
import numpy as np
import orjson

from benchmarks.common import verdict
from service.client import COLUMNS, Client, columns
from service.datasets import VICTORIA_PARK, Dataset, read_source
from service.standalone import own_service
from submaps.config import MapConfig, MotionConfig, ObservationConfig
from submaps.mapper import Mapper
from submaps.simulation import World, drive

ROUNDS = 7


def in_process(run: Dataset) -> float:
    """Observations a second of one map."""
    batches = [batch for _, batch in run.batches()]
    mapper = Mapper(MapConfig(run.motion, run.observation))
    began = time.perf_counter()
    for batch in batches:
        mapper.apply("robot", batch)
    return run.columns.observations / (time.perf_counter() - began)


def through_http(url: str, run: Dataset, bodies: list[bytes], maps: list[str], clients: int) -> tuple[float, float]:
    """Observations a second of all clients together, each with its share of new maps; syncs a batch."""
    with Client(url) as client:
        for name in maps:
            client.create_map(name, MapConfig(run.motion, run.observation))
    shares = [maps[k::clients] for k in range(clients)]
    waits = syncs(url)
    with ThreadPoolExecutor(clients) as pool:
        began = time.perf_counter()
        for _ in pool.map(lambda share: fill(url, bodies, share), shares):
            pass
        seconds = time.perf_counter() - began
    rate = len(maps) * run.columns.observations / seconds
    a_batch = (syncs(url) - waits) / (len(maps) * len(bodies))
    return rate, a_batch


def fill(url: str, bodies: list[bytes], maps: list[str]) -> None:
    connection = http.client.HTTPConnection(urlsplit(url).netloc)
    for name in maps:
        for body in bodies:
            path = f"/v1/maps/{name}/robots/robot/measurements"
            connection.request("POST", path, body, {"content-type": COLUMNS})
            answer = connection.getresponse()
            said = answer.read()
            if answer.status != 200:
                raise RuntimeError(f"{answer.status}: {said[:200]!r}")
    connection.close()


def syncs(url: str) -> int:
    found = re.search(r"^submaps_journal_syncs_total (\d+)", httpx.get(f"{url}/metrics").text, re.MULTILINE)
    if found is None:
        raise RuntimeError("the service counts no syncs")
    return int(found[1])


def hall(steps: int = 1000) -> Dataset:
    """Rounds of 5 m radius in a hall of fifty landmarks, about ten of them within 7 m of the robot."""
    rng = np.random.default_rng(1)
    angle, distance = rng.uniform(0.0, 2.0 * np.pi, 50), 13.0 * np.sqrt(rng.uniform(size=50))
    landmarks = np.stack([distance * np.cos(angle), 5.0 + distance * np.sin(angle)], axis=1)
    motion, sigma = (0.02, 0.002), 0.05
    world = World(landmarks, np.tile([1.0, 0.2], (steps, 1)), 1.0, 7.0, 1, motion, sigma)
    run = drive(world, rng)
    sensor = ObservationConfig("cartesian", (sigma, sigma))
    return Dataset.single("hall", MotionConfig("velocity", motion), sensor, run.batch)


def main() -> None:
    parser = argparse.ArgumentParser(description="Durable ingest through HTTP against the same batches in process.")
    parser.add_argument("--maps", type=int, default=4, help="maps filled in each round")
    parser.add_argument("--clients", type=int, default=4, help="clients at once")
    options = parser.parse_args()
    for run in (hall(), read_source(VICTORIA_PARK)):
        measure(run, options.maps, options.clients)


def measure(run: Dataset, maps: int, clients: int) -> None:
    bodies = [
        orjson.dumps(columns(k, batch), option=orjson.OPT_SERIALIZE_NUMPY)
        for k, (_, batch) in enumerate(run.batches(), start=1)
    ]
    size = sum(map(len, bodies)) / run.columns.observations
    steps = run.columns.steps / run.columns.observations
    print(f"{run.name}: {len(bodies)} batches a map, {steps:.1f} steps and {size:.0f} bytes an observation")
    with own_service() as url:
        through_http(url, run, bodies, ["warm"], 1)
        in_process(run)
        for count in (1, clients):
            rounds = []
            for k in range(ROUNDS):  # in turn, since the machine's speed drifts
                base = statistics.median(in_process(run) for _ in range(3))
                names = [f"by{count}-{k}-{m}" for m in range(maps)]
                rate, a_batch = through_http(url, run, bodies, names, count)
                rounds.append((base / rate, base, rate, a_batch))
            ratio, base, rate, a_batch = (statistics.median(values) for values in zip(*rounds, strict=True))
            print(f"  {count} at once: {rate:,.0f} observations/s, {a_batch:.2f} syncs a batch; ", end="")
            print(f"in process {base:,.0f}, {1e6 / base:.2f} µs each")
            print("    " + verdict("in process by HTTP", ratio, 2.0, "{:.2f} x".format))


if __name__ == "__main__":
    main()
