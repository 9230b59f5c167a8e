"""Durable ingest through HTTP against the same batches applied in process.

Victoria Park in column batches of 1 000 observations, into one new map after another: by one
client that waits for each acknowledgement, then by several at once, each with maps of its own.
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
import orjson

from benchmarks.common import verdict
from service.client import COLUMNS, Client, columns
from service.datasets import VICTORIA_PARK, Dataset, read_source
from service.standalone import own_service
from submaps.config import MapConfig
from submaps.mapper import Mapper


def in_process(run: Dataset) -> float:
    """Observations a second of one map."""
    batches = list(run.batches())
    mapper = Mapper(MapConfig(run.motion, run.observation))
    began = time.perf_counter()
    for batch in batches:
        mapper.apply("robot", batch)
    return run.columns.observations / (time.perf_counter() - began)


def through_http(url: str, run: Dataset, bodies: list[bytes], maps: list[str], clients: int) -> float:
    """Observations a second of all clients together, each filling its share of new maps in turn."""
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
    print(f"{clients} client{'s' * (clients > 1)}: {rate:,.0f} observations/s, {a_batch:.2f} syncs a batch")
    return rate


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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--maps", type=int, default=12, help="maps filled in each measurement")
    parser.add_argument("--clients", type=int, default=4, help="clients at once")
    options = parser.parse_args()
    run = read_source(VICTORIA_PARK)
    bodies = [
        orjson.dumps(columns(k, batch), option=orjson.OPT_SERIALIZE_NUMPY)
        for k, batch in enumerate(run.batches(), start=1)
    ]
    print(f"{len(bodies)} batches a map, {sum(map(len, bodies)) / run.columns.observations:.0f} bytes an observation")
    in_process(run)
    base = statistics.median(in_process(run) for _ in range(9))
    print(f"in process: {base:,.0f} observations/s")
    with own_service() as url:
        through_http(url, run, bodies, ["warm"], 1)
        for clients in (1, options.clients):
            names = [f"by{clients}-{k}" for k in range(options.maps)]
            rate = through_http(url, run, bodies, names, clients)
            print("  " + verdict("in process by HTTP", base / rate, 2.0, "{:.2f} x".format))


if __name__ == "__main__":
    main()
