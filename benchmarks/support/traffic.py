"""Robots that send batches and ask for poses: at a stated rate, or as fast as answers come.

At a rate the loop is open: each request has its time, and its latency counts from then, whether or
not the robot was still waiting for the answer before (no coordinated omission).
"""

from __future__ import annotations

import asyncio
import itertools
import math
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import orjson

from benchmarks.support.figures import Tally, metrics
from benchmarks.support.http import Connection, get, post, run
from benchmarks.support.worlds import MOTION, OBSERVATION, Drive, Lap
from service.client import COLUMNS, Client, columns
from submaps.config import MapConfig
from submaps.measurements import Batch

_MOST_PREPARED_BYTES = 512 * 2**20
_QUERY_CONNECTIONS = 8


@dataclass(frozen=True)
class Shape:
    """What a request holds: steps, at most so many observations a step, rows or columns."""

    steps: int = 1
    observations: int | None = None
    rows: bool = False


class Robot:
    """A robot on a map: its requests, in order."""

    def __init__(self, map_: str, name: str, drive: Drive, shape: Shape) -> None:
        self.map, self.name = map_, name
        self.observations = 0  # in the requests handed out
        self._drive, self._shape = drive, shape
        self._sequence = 0
        self._prepared: deque[tuple[bytes, int]] = deque()
        self._path = f"/v1/maps/{map_}/robots/{name}/measurements"
        self.pose = get(f"/v1/maps/{map_}/robots/{name}/pose?frame=map")

    def prepare(self, count: int, most_bytes: int) -> None:
        """Make the next ``count`` requests beforehand, or as many as fit."""
        while len(self._prepared) < count and most_bytes > 0:
            self._prepared.append(self._make())
            most_bytes -= len(self._prepared[-1][0])

    def repeater(self) -> Repeater:
        """A robot that sends what was prepared for this one, again and again."""
        return Repeater(self.pose, [message for message, _ in self._prepared])

    def take(self) -> bytes:
        """The next request."""
        message, observations = self._prepared.popleft() if self._prepared else self._make()
        self.observations += observations
        return message

    def _make(self) -> tuple[bytes, int]:
        self._sequence += 1
        batch = self._drive.next(self._shape.steps, self._shape.observations)
        if self._shape.rows:
            return post(self._path, "application/json", orjson.dumps(rows(self._sequence, batch))), batch.observations
        body = orjson.dumps(columns(self._sequence, batch), option=orjson.OPT_SERIALIZE_NUMPY)
        return post(self._path, COLUMNS, body), batch.observations


class Repeater:
    """A robot that sends the same requests again and again, to whoever does not mind."""

    def __init__(self, pose: bytes, messages: list[bytes]) -> None:
        self.observations = 0
        self.pose = pose
        self._messages = itertools.cycle(messages)

    def take(self) -> bytes:
        """The next request."""
        return next(self._messages)


def rows(sequence: int, batch: Batch) -> dict[str, Any]:
    """A batch as rows."""
    steps: list[dict[str, Any]] = [{"t": t, "observations": []} for t in batch.t.tolist()]
    for k, (dx, dy, dtheta) in zip(batch.control_step.tolist(), batch.control.T.tolist(), strict=True):
        steps[k]["odometry"] = {"dx": dx, "dy": dy, "dtheta": dtheta}
    for k, name, (x, y) in zip(batch.observation_step.tolist(), batch.landmark, batch.z.T.tolist(), strict=True):
        steps[k]["observations"].append({"landmark": name, "x": x, "y": y})
    return {"sequence": sequence, "steps": steps}


def fleet(
    url: str, lap: Lap, robots: int, maps: int, shape: Shape, *, name: str = "load", seed: int = 0
) -> list[Robot]:
    """Make maps and their robots, dealt out in turn; those of a map start at even distances round its lap."""
    with Client(url) as client:
        for m in range(maps):
            client.create_map(f"{name}-{m}", MapConfig(MOTION, OBSERVATION))
    a_map = -(-robots // maps)
    starts = np.linspace(0, lap.steps, a_map, endpoint=False).astype(int)
    return [
        Robot(f"{name}-{r % maps}", f"r{r}", Drive(lap, int(starts[r // maps]), seed + r), shape)
        for r in range(robots)
    ]  # fmt: skip


@dataclass(frozen=True)
class Plan:
    """Which load: ``rate`` requests/s of all robots together and ``queries``/s; 0 as fast as answers come.

    ``queries`` of ``None`` asks nothing. The first ``warm_up`` seconds are not counted.
    """

    seconds: float
    rate: float = 0.0
    queries: float | None = None
    warm_up: float = 0.0
    ingest: bool = True


@dataclass
class Outcome:
    """What came of a load: answers; each robot's good ones and its longest wait (s).

    ``observations`` and ``requests`` were sent, the warm-up's included; ``cpu_seconds`` is of the
    process that sends; ``rose`` says by how much each of the service's own figures rose meanwhile.
    """

    ingest: Tally
    queries: Tally
    by_robot: list[int]
    longest: list[float]
    observations: int
    requests: int
    cpu_seconds: float
    rose: dict[str, float] = field(default_factory=dict)

    def each(self, name: str) -> float:
        """A figure of the service for each request sent, nan where it does not say."""
        return self.rose.get(name, math.nan) / self.requests if self.requests else math.nan


def prepare(robots: list[Robot], plan: Plan, guess: float = 4000.0) -> None:
    """Make the requests of a plan beforehand, as far as memory allows."""
    count = round((plan.rate or guess) * (plan.seconds + plan.warm_up) / len(robots)) + 1
    for robot in robots:
        robot.prepare(count, _MOST_PREPARED_BYTES // len(robots))


def measure(url: str, robots: Sequence[Robot | Repeater], plan: Plan) -> Outcome:
    """Run a load to its end, and ask the service what it took."""
    before = metrics(url)
    done = run(drive(url, robots, plan), len(robots) + _QUERY_CONNECTIONS)
    after = metrics(url)
    done.rose = {name: value - before.get(name, 0.0) for name, value in after.items()}
    return done


async def drive(url: str, robots: Sequence[Robot | Repeater], plan: Plan) -> Outcome:
    """Run a load to its end."""
    requests = 0
    ingest, queries = Tally(seconds=plan.seconds), Tally(seconds=plan.seconds)
    by_robot, longest = [0] * len(robots), [0.0] * len(robots)
    sent_before = sum(robot.observations for robot in robots)
    senders = [await Connection.open(url) for _ in robots] if plan.ingest else []
    askers = [await Connection.open(url) for _ in range(_QUERY_CONNECTIONS)] if plan.queries is not None else []
    cpu = time.process_time()
    begin = time.perf_counter() + plan.warm_up
    end = begin + plan.seconds

    async def send(j: int, robot: Robot | Repeater, connection: Connection) -> None:
        k = 0
        while True:
            due = begin - plan.warm_up + (k * len(robots) + j) / plan.rate if plan.rate else time.perf_counter()
            k += 1
            if due >= end:
                return
            status, took = await _one(connection, robot.take(), due, ingest)
            if due >= begin and status < 400:
                by_robot[j] += 1
                longest[j] = max(longest[j], took)
            if status >= 400:
                return  # what follows would be a gap in the robot's sequence

    async def _one(connection: Connection, message: bytes, due: float, tally: Tally) -> tuple[int, float]:
        nonlocal requests
        requests += 1
        wait = due - time.perf_counter()
        if wait > 0.0:
            await asyncio.sleep(wait)
        try:
            status, _ = await connection.request(message)
        except ConnectionError:
            tally.statuses["closed"] += 1
            return 599, 0.0
        took = time.perf_counter() - due
        if due >= begin:
            tally.add(took, status)
        return status, took

    async def ask(j: int, connection: Connection) -> None:
        k = 0
        while True:
            number = k * len(askers) + j
            rate = plan.queries or 0.0
            due = begin - plan.warm_up + number / rate if rate else time.perf_counter()
            k += 1
            if due >= end:
                return
            status, _ = await _one(connection, robots[number % len(robots)].pose, due, queries)
            if status == 599:
                return

    try:
        sending = [send(j, robot, c) for j, (robot, c) in enumerate(zip(robots, senders, strict=False))]
        await asyncio.gather(*sending, *(ask(j, c) for j, c in enumerate(askers)))
    finally:
        for connection in (*senders, *askers):
            connection.close()
    observations = sum(robot.observations for robot in robots) - sent_before
    return Outcome(ingest, queries, by_robot, longest, observations, requests, time.process_time() - cpu)
