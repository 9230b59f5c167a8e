"""When the atlas is solved: off the ingest path, one map at a time, at most half of one core."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Awaitable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Protocol

from service.hosted import Hosted, Solve
from service.problems import Problem, not_found
from submaps.atlas.joining import join
from submaps.atlas.solution import Solution
from submaps.atlas.state import AtlasState

# Maps that may be captured or published at once: either waits its turn behind the measurements of all maps.
AT_ONCE = 16

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Solved:
    """What a solve found, the digest of what it started from, and the time it took (s)."""

    solution: Solution
    problem_digest: bytes
    seconds: float


class Captures(Protocol):
    """What the solver asks of the engine."""

    def capture(self, hosted: Hosted) -> Awaitable[tuple[int, AtlasState]]:
        """Capture a map's problem between two of its events."""

    def publish(self, hosted: Hosted, base: int, number: int, solved: Solved) -> Awaitable[Solve]:
        """Send a solve through the journal into its map."""


class Solver:
    """Solves the maps that want it, in the order in which they asked; used on the event loop."""

    def __init__(self, engine: Captures) -> None:
        self._engine = engine
        self._wanted: dict[Hosted, None] = {}
        self._some = asyncio.Event()
        self._executor = ThreadPoolExecutor(1, "solver")
        self._task: asyncio.Task[None] | None = None
        self._solving: dict[Hosted, asyncio.Task[None]] = {}
        self._turn = asyncio.Lock()
        self._rested = 0.0  # the moment (s) from which on a thread may solve again
        self.solved = 0
        self.failed = 0
        self.seconds = 0.0

    def start(self) -> None:
        """Begin to solve."""
        self._task = asyncio.get_running_loop().create_task(self._run())

    async def close(self) -> None:
        """Stop; a solve under way is not published."""
        if self._task is not None:
            tasks = [self._task, *self._solving.values()]
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks)
        await asyncio.to_thread(self._executor.shutdown)

    def want(self, hosted: Hosted) -> None:
        """Ask for a solve of a map; several who ask share the next one."""
        self._wanted[hosted] = None
        self._some.set()

    def join_next(self, hosted: Hosted) -> tuple[int, asyncio.Future[Solve]]:
        """Return the number of the next solve to be captured, and what will become of it."""
        done = asyncio.get_running_loop().create_future()
        done.add_done_callback(_look_at)
        hosted.waiting.append(done)
        self.want(hosted)
        return hosted.begun + 1, done

    async def _run(self) -> None:
        while True:
            await self._some.wait()
            self._some.clear()
            # A map that is being solved waits: nothing may be captured between a capture and its solve.
            for hosted in [one for one in self._wanted if one not in self._solving]:
                if len(self._solving) == AT_ONCE:
                    break
                del self._wanted[hosted]
                task = asyncio.get_running_loop().create_task(self._solve(hosted))
                self._solving[hosted] = task
                task.add_done_callback(partial(self._done, hosted))

    def _done(self, hosted: Hosted, _: asyncio.Task[None]) -> None:
        del self._solving[hosted]
        if self._wanted:
            self._some.set()

    async def _solve(self, hosted: Hosted) -> None:
        hosted.begun += 1
        number, waiting = hosted.begun, hosted.waiting
        hosted.waiting = []
        outcome: Solve | Problem
        try:
            hosted.check_usable()
            base, problem = await self._engine.capture(hosted)
            solved = await self._in_turn(problem)
            outcome = await self._engine.publish(hosted, base, number, solved)
            self.solved += 1
        except Problem as problem_:
            outcome = problem_
        except Exception as error:
            log.exception("solve %d of map %r failed", number, hosted.id)
            outcome = Problem(500, "solve-failed", f"Solve {number} failed: {error}")
        self._tell(hosted, number, waiting, outcome)

    async def _in_turn(self, problem: AtlasState) -> Solved:
        """Solve in the thread for that, which then rests as long as it took: half of one core at most."""
        loop = asyncio.get_running_loop()
        async with self._turn:
            await asyncio.sleep(max(self._rested - loop.time(), 0.0))
            solved = await loop.run_in_executor(self._executor, _timed, problem)
            self._rested = loop.time() + solved.seconds
        self.seconds += solved.seconds
        return solved

    def _tell(
        self,
        hosted: Hosted,
        number: int,
        waiting: list[asyncio.Future[Solve]],
        outcome: Solve | Problem,
    ) -> None:
        self.failed += isinstance(outcome, Problem) and not hosted.deleted
        hosted.keep(number, outcome)
        for done in waiting:
            if done.done():
                continue
            if isinstance(outcome, Solve):
                done.set_result(outcome)
            else:
                done.set_exception(not_found("map", hosted.id) if hosted.deleted else outcome)


def _timed(problem: AtlasState) -> Solved:
    began = time.perf_counter()
    problem_digest = problem.digest()
    solution = join(problem)
    solution.prepare()
    return Solved(solution, problem_digest, time.perf_counter() - began)


def _look_at(done: asyncio.Future[Solve]) -> None:
    """Keep asyncio from reporting a failure that nobody waited for (``wait=false``)."""
    if not done.cancelled():
        done.exception()
