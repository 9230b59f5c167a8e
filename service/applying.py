"""Bringing maps forward by what the journal holds: the same code live and in recovery."""

from __future__ import annotations

import asyncio
import logging
import queue
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from service.acknowledgements import derive
from service.hosted import Hosted, Pending, PendingBatch, PendingChange, PendingRobot, PendingSolve, Solve
from service.problems import Problem, not_found
from service.runtime import Configured, Measured, Solved
from service.store.base import BatchEvent, Derived, Journal, Outcome, RobotEvent, SolveEvent
from service.store.encoding import unpack
from submaps.atlas.solution import Solution
from submaps.atlas.state import AtlasState
from submaps.config import RobotConfig
from submaps.measurements import Batch

log = logging.getLogger(__name__)

TOLD_AT_ONCE_BYTES = 8 * 1024  # of a batch: above, its sender does not wait for the rest of its group

# What became of something: a result of its future's type, or an error to raise there.
Result = tuple[asyncio.Future[Any], Any]
Tell = Callable[[Sequence[Result], Sequence[Pending], Exception | None], None]


def apply_batch(hosted: Hosted, event: BatchEvent, batch: Batch) -> Derived:
    """Apply a batch, and return what to keep of it."""
    runtime = hosted.runtime
    report = runtime.apply(Measured(event.position, event.robot, batch))
    assert report is not None  # a batch always gives one
    return derive(event, batch, report, runtime.version)


def apply_robot(hosted: Hosted, event: RobotEvent, own: RobotConfig) -> None:
    """Set a robot apart from its map's defaults."""
    hosted.runtime.apply(Configured(event.position, event.robot, own))


def apply_solve(hosted: Hosted, event: SolveEvent, solution: Solution | None = None) -> Solve:
    """Apply a solve, from its ``solution`` where it was made here, and return what is told of it."""
    columns = unpack("solve", event.data)[1] if solution is None else solution.columns()
    hosted.runtime.apply(Solved(event.position, event.base, event.problem_digest, columns, solution))
    return Solve(event.number, hosted.runtime.version, event.seconds, event.iterations, event.cost)


@dataclass(eq=False)
class Capture:
    """A wish for a map's problem, as it stands between two events."""

    hosted: Hosted
    done: asyncio.Future[tuple[int, AtlasState]]


class Applier:
    """The thread that applies what has become durable, publishes views, and tells of it.

    ``tell`` is called from this thread, once for each group.
    """

    def __init__(self, journal: Journal, tell: Tell) -> None:
        self._journal = journal
        self._tell = tell
        self._work: queue.SimpleQueue[Outcome | Capture | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="apply")

    @property
    def running(self) -> bool:
        """Whether the thread runs."""
        return self._thread.is_alive()

    def start(self) -> None:
        """Begin to apply."""
        self._thread.start()

    def stop(self) -> None:
        """Finish what was put, and stop."""
        self._work.put(None)
        self._thread.join()

    def put(self, work: Outcome | Capture) -> None:
        """Hand in a group of the journal's, or a wish."""
        self._work.put(work)

    def _run(self) -> None:
        while (work := self._work.get()) is not None:
            if isinstance(work, Capture):
                self._tell([(work.done, _attempt(work.hosted.runtime.capture))], (), None)
            elif work.error is not None:
                problem = Problem(503, "journal-failed", f"The journal cannot be written: {work.error}.")
                self._tell([(pending.done, problem) for pending in work.tokens], work.tokens, work.error)
            else:
                self._apply_group(work.tokens)

    def _apply_group(self, group: Sequence[Pending]) -> None:
        """Apply a group, and tell of its parts: each ends with a batch that took its time to apply.

        Told of all at once, clients with large batches would fall into step: all of them sending
        while nothing is applied, then all of them waiting.
        """
        part: list[Pending] = []
        for pending in group:
            part.append(pending)
            if isinstance(pending, PendingBatch) and len(pending.event.data) > TOLD_AT_ONCE_BYTES:
                self._apply_part(part)
                part = []
        if part:
            self._apply_part(part)

    def _apply_part(self, part: Sequence[Pending]) -> None:
        kept: list[Derived] = []
        results = [(pending.done, self._apply(pending, kept)) for pending in part]
        for hosted in dict.fromkeys(pending.hosted for pending in part):
            if not hosted.halted:
                hosted.view = hosted.runtime.view()
        if kept:
            self._journal.derive(kept)
        self._tell(results, part, None)

    def _apply(self, pending: Pending, kept: list[Derived]) -> Any:
        """Return what became of one entry: its result, or the ``Problem`` to answer with."""
        hosted = pending.hosted
        if isinstance(pending, PendingChange):
            return None
        if hosted.deleted:
            return not_found("map", hosted.id)
        if hosted.halted:
            return hosted.stopped()
        try:
            if isinstance(pending, PendingSolve):
                return apply_solve(hosted, pending.event, pending.solution)
            if isinstance(pending, PendingRobot):
                return apply_robot(hosted, pending.event, pending.own)
            derived = apply_batch(hosted, pending.event, pending.batch)
        except Exception as error:
            # The journal holds it, so nothing later may be applied: the map would diverge from it.
            log.exception("map %r halted at event %d", hosted.id, pending.event.position)
            hosted.halted = f"event {pending.event.position} cannot be applied ({error})"
            return hosted.stopped()
        kept.append(derived)
        return derived.acknowledgement


def _attempt(call: Callable[[], Any]) -> Any:
    try:
        return call()
    except Exception as error:
        return error
