"""The engine: groups, faults of our own, a journal that fails."""

from __future__ import annotations

import asyncio
import json
import threading
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from itertools import pairwise
from pathlib import Path

import orjson
import pytest

from service.engine import Engine
from service.hosted import Hosted
from service.problems import Problem
from service.store.sqlite import SqliteJournal
from service.wire.base import parse
from service.wire.columns import ROWS_TYPE, decode
from service.wire.maps import MAP_REQUEST
from submaps.atlas import joining
from submaps.atlas.solution import Solution
from submaps.atlas.state import AtlasState
from submaps.mapper import Mapper
from submaps.measurements import Batch, Report
from tests.service.support import ODOMETRY_MAP, Json, batches

CONFIG = parse(MAP_REQUEST, json.dumps(ODOMETRY_MAP).encode())


@asynccontextmanager
async def running(path: Path) -> AsyncIterator[Engine]:
    engine = Engine(SqliteJournal(path))
    await engine.start()
    try:
        yield engine
    finally:
        await engine.close()


async def make(engine: Engine, id_: str = "park") -> Hosted:
    return await engine.create(id_, CONFIG.config().model_dump_json().encode(), CONFIG.to_core())


async def send(engine: Engine, hosted: Hosted, body: Json, robot: str = "r1") -> Json:
    decoded = decode(ROWS_TYPE, json.dumps(body).encode(), hosted.core, "r1")
    acknowledgement: Json = orjson.loads(await engine.ingest(hosted, robot, decoded))
    return acknowledgement


def run(test: Callable[[], Awaitable[None]]) -> None:
    async def main() -> None:
        await test()

    asyncio.run(main())


def test_batches_that_come_together_share_syncs(tmp_path: Path) -> None:
    async def test() -> None:
        async with running(tmp_path) as engine:
            hosted = await make(engine)
            before = engine.journal.stats.syncs
            for body in batches(5, 2):
                decoded = decode(ROWS_TYPE, json.dumps(body).encode(), hosted.core, "r1")
                await asyncio.gather(*(engine.ingest(hosted, f"r{k}", decoded) for k in range(32)))
            assert engine.counters.batches == 160
            assert engine.journal.stats.syncs - before <= 60

    run(test)


def test_one_client_alone_costs_one_sync_a_batch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is derived waits for the next entry; only solves, which are entries too, add syncs."""
    monkeypatch.setattr("service.store.sqlite.IDLE_SECONDS", 60.0)

    async def test() -> None:
        async with running(tmp_path) as engine:
            hosted = await make(engine)
            stats = engine.journal.stats
            syncs, entries = stats.syncs, stats.entries
            for body in batches(50, 2):
                await send(engine, hosted, body)
            assert stats.entries - entries >= 50
            assert stats.syncs - syncs <= stats.entries - entries

    run(test)


def test_a_repeat_is_answered_though_the_first_sender_is_gone(tmp_path: Path) -> None:
    async def test() -> None:
        async with running(tmp_path) as engine:
            hosted = await make(engine)
            body, following = batches(2, 2)
            first, again = (asyncio.create_task(send(engine, hosted, body)) for _ in range(2))
            await asyncio.sleep(0)  # both wait
            first.cancel()
            answer = await again
            assert (answer["sequence"], answer["duplicate"]) == (1, True)
            assert (await send(engine, hosted, following))["sequence"] == 2

    run(test)


@pytest.fixture
def faulty(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """An estimator with a fault: a landmark named "bug" makes it fail."""
    whole = Mapper.apply

    def apply(self: Mapper, robot: str, batch: Batch) -> Report:
        if "bug" in batch.landmark:
            raise RuntimeError("a fault of our own")
        return whole(self, robot, batch)

    monkeypatch.setattr(Mapper, "apply", apply)
    return monkeypatch


def with_bug(body: Json) -> Json:
    body["steps"][-1]["observations"].append({"landmark": "bug", "x": 1.0, "y": 1.0})
    return body


def test_a_fault_halts_the_map_and_loses_nothing(tmp_path: Path, faulty: pytest.MonkeyPatch) -> None:
    first, second, third = batches(3, 10)

    async def until_the_fault() -> None:
        async with running(tmp_path) as engine:
            hosted, other = await make(engine), await make(engine, "yard")
            await send(engine, hosted, first)
            before = hosted.view.counts()
            sent = [send(engine, hosted, with_bug(second)), send(engine, hosted, third)]
            for answer in await asyncio.gather(*sent, return_exceptions=True):
                assert isinstance(answer, Problem)
                assert (answer.status, answer.type) == (500, "map-halted")
            with pytest.raises(Problem, match="a fault of our own"):
                await send(engine, hosted, third)
            assert hosted.view.counts() == before
            await send(engine, other, first)  # other maps go on

    async def started_again() -> None:
        async with running(tmp_path) as engine:
            assert engine.maps["park"].halted
            assert engine.maps["park"].view.counts()["steps"] == 10
            assert engine.maps["yard"].halted is None
            with pytest.raises(Problem, match="cannot be replayed"):
                await send(engine, engine.maps["park"], third)

    async def mended() -> None:
        async with running(tmp_path) as engine:
            hosted = engine.maps["park"]
            assert hosted.view.counts()["steps"] == 30
            assert (await send(engine, hosted, third))["duplicate"] is True

    run(until_the_fault)
    run(started_again)
    faulty.undo()
    run(mended)


def test_a_journal_that_fails_acknowledges_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first, second, third = batches(3, 10)

    async def test() -> None:
        async with running(tmp_path) as engine:
            hosted = await make(engine)
            await send(engine, hosted, first)

            def full(*_: object) -> None:
                raise OSError("no space left")

            monkeypatch.setattr(engine.journal, "_insert", full)
            for answer in await asyncio.gather(
                send(engine, hosted, second), send(engine, hosted, third), return_exceptions=True
            ):
                assert isinstance(answer, Problem)
                assert (answer.status, answer.type) == (503, "journal-failed")
            assert hosted.view.counts()["steps"] == 10
            monkeypatch.undo()
            with pytest.raises(Problem, match="cannot be written"):
                await send(engine, hosted, third)

    async def started_again() -> None:
        async with running(tmp_path) as engine:
            hosted = engine.maps["park"]
            assert hosted.view.counts()["steps"] == 10
            assert (await send(engine, hosted, second))["duplicate"] is False

    run(test)
    run(started_again)


def test_a_solve_that_fails_is_told_and_harms_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_: object) -> None:
        raise RuntimeError("no convergence")

    async def test() -> None:
        async with running(tmp_path) as engine:
            hosted = await make(engine)
            first, second = batches(2, 10)
            await send(engine, hosted, first)
            monkeypatch.setattr("service.solving.join", fail)
            _, done = engine.solver.join_next(hosted)
            with pytest.raises(Problem, match="no convergence"):
                await done
            monkeypatch.undo()
            await send(engine, hosted, second)
            number, done = engine.solver.join_next(hosted)
            assert (await done).number == number

    run(test)


def test_calls_that_come_together_share_a_solve(tmp_path: Path) -> None:
    async def test() -> None:
        async with running(tmp_path) as engine:
            hosted = await make(engine)
            await send(engine, hosted, batches(1, 10)[0])
            joined = [engine.solver.join_next(hosted) for _ in range(8)]
            solves = await asyncio.gather(*(done for _, done in joined))
            assert {number for number, _ in joined} == {solve.number for solve in solves} == {1}

    run(test)


def test_solving_takes_half_of_one_core_at_most(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    spans: list[tuple[float, float]] = []
    whole = joining.join

    def slow(problem: AtlasState) -> Solution:
        began = time.perf_counter()
        time.sleep(0.1)
        solution = whole(problem)
        spans.append((began, time.perf_counter()))
        return solution

    async def test() -> None:
        async with running(tmp_path) as engine:
            hosted = await make(engine)
            await send(engine, hosted, batches(1, 10)[0])
            monkeypatch.setattr("service.solving.join", slow)
            for _ in range(3):
                _, done = engine.solver.join_next(hosted)
                await done

    run(test)
    for before, after in pairwise(spans):
        assert after[0] - before[1] >= 0.9 * (before[1] - before[0])


def test_a_late_solve_of_a_deleted_map_is_dropped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begun, go_on = threading.Event(), threading.Event()
    whole = joining.join

    def held(problem: AtlasState) -> Solution:
        begun.set()
        go_on.wait(10)
        return whole(problem)

    async def test() -> None:
        async with running(tmp_path) as engine:
            hosted = await make(engine)
            await send(engine, hosted, batches(1, 10)[0])
            monkeypatch.setattr("service.solving.join", held)
            _, done = engine.solver.join_next(hosted)
            await asyncio.to_thread(begun.wait, 10)
            await engine.delete("park")
            again = await make(engine)
            go_on.set()
            with pytest.raises(Problem) as gone:
                await done
            assert gone.value.status == 404
            assert (hosted.position, again.position, again.view.version) == (1, 0, 0)

    run(test)
