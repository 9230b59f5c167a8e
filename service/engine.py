"""The engine owns the maps: admit, journal, apply, publish, acknowledge.

Three threads share the work. The event loop admits, and alone decides what enters the journal. The
journal's thread makes groups durable. The applying thread brings the maps forward and swaps their
views in; then one call wakes the event loop for the whole group.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from service import recovery
from service.acknowledgements import as_duplicate
from service.applying import Applier, Capture, Result
from service.hosted import (
    Admitted,
    Hosted,
    Pending,
    PendingBatch,
    PendingChange,
    PendingRobot,
    PendingSolve,
    Solve,
)
from service.problems import Problem, not_found
from service.runtime import Runtime
from service.solving import Solved, Solver
from service.store.base import (
    BatchEvent,
    CreateMap,
    DeleteMap,
    Entry,
    Journal,
    RobotEvent,
    SolveEvent,
    StoreError,
)
from service.store.encoding import digest, encode_batch, pack
from service.wire.columns import Decoded
from submaps.atlas.state import AtlasState
from submaps.config import MapConfig, RobotConfig

KEPT_ACKNOWLEDGEMENTS = 1000

log = logging.getLogger(__name__)


@dataclass
class Counters:
    """What the engine did since it started."""

    batches: int = 0
    duplicates: int = 0
    steps: int = 0
    observations: int = 0


class Engine:
    """All the maps of a server; every method is called on the event loop."""

    def __init__(self, journal: Journal) -> None:
        self.journal = journal
        self.counters = Counters()
        self.maps: dict[str, Hosted] = {}
        self.unready: str | None = "recovering from the journal"
        self._next_key = 1
        self._outgoing: list[tuple[Entry, Pending]] = []  # to the journal, in this turn of the event loop
        self._applier = Applier(journal, self._tell)
        self.solver = Solver(self)

    # -- life ------------------------------------------------------------------------------------

    async def start(self) -> None:
        """Recover every map from the journal, then take requests."""
        self._loop = asyncio.get_running_loop()
        try:
            hosted = await asyncio.to_thread(lambda: list(recovery.recover(self.journal)))
        except Exception as error:
            self.unready = f"the journal cannot be read ({error})"
            raise
        self.maps = {one.id: one for one in hosted}
        self._next_key = self.journal.next_key()
        self._applier.start()
        self.journal.start(self._applier.put)
        self.solver.start()
        self.unready = None
        for one in hosted:
            if one.halted is None and one.runtime.solve_due:
                self.solver.want(one)

    async def close(self) -> None:
        """Finish what was admitted, and stop."""
        self.unready = "stopped"
        await self.solver.close()
        self._hand_over()
        await asyncio.to_thread(self._close)

    def _close(self) -> None:
        if self._applier.running:
            try:
                self.journal.flush()  # the applying thread has been handed all of it
            except StoreError as error:
                log.error("at the end: %s", error)
            self._applier.stop()
        self.journal.close()

    def check_ready(self) -> None:
        """Raise ``Problem`` (503) where the engine does not take requests."""
        if self.unready is not None:
            raise Problem(
                503, "not-ready", f"The service is not ready: {self.unready}.",
                headers={"Retry-After": "1"},
            )  # fmt: skip

    # -- maps ------------------------------------------------------------------------------------

    def map(self, id_: str) -> Hosted:
        """Return a map; raises ``Problem`` where there is none (404)."""
        self.check_ready()
        if id_ not in self.maps:
            raise not_found("map", id_)
        return self.maps[id_]

    async def create(self, id_: str, config: bytes, core: MapConfig) -> Hosted:
        """Make a map; raises ``Problem`` (409) where the id is taken."""
        self.check_ready()
        if id_ in self.maps:
            raise Problem(409, "map-exists", f"There is a map {id_!r} already.")
        runtime = Runtime(core)
        hosted = Hosted(self._next_key, id_, config, core, runtime, runtime.view())
        self._next_key += 1
        # Visible at once: whatever reaches it follows it into the journal.
        self.maps[id_] = hosted
        await self._change(hosted, CreateMap(hosted.key, id_, config))
        return hosted

    async def delete(self, id_: str) -> None:
        """Delete a map; its id is free, what is in flight gets 404, a late solve is dropped."""
        hosted = self.map(id_)
        hosted.deleted = True
        del self.maps[id_]
        for done in hosted.waiting:
            if not done.done():
                done.set_exception(not_found("map", id_))
        hosted.waiting = []
        await self._change(hosted, DeleteMap(hosted.key))

    async def _change(self, hosted: Hosted, entry: CreateMap | DeleteMap) -> None:
        done: asyncio.Future[None] = self._loop.create_future()
        self._append(entry, PendingChange(hosted, done))
        await done

    # -- robots ----------------------------------------------------------------------------------

    async def configure(self, hosted: Hosted, robot: str, data: bytes, own: RobotConfig) -> None:
        """Set a robot apart from its map's defaults; ``data`` is ``own`` as JSON.

        Raises ``Problem``: 404, 409 where the robot has sent a batch, or 500 where the map has stopped.
        """
        self.check_ready()
        hosted.check_usable()
        hosted.check_new(robot, own.start)
        hosted.position += 1
        # At once: a batch that arrives from now on follows it into the journal.
        hosted.own[robot] = own
        event = RobotEvent(hosted.key, hosted.position, robot, data)
        pending = PendingRobot(hosted, event, own, self._loop.create_future())
        self._append(event, pending)
        await asyncio.shield(pending.done)

    def _append(self, entry: Entry, pending: Pending) -> None:
        """Send an entry to the journal, along with the others of this turn of the event loop."""
        if not self._outgoing:
            self._loop.call_soon(self._hand_over)
        self._outgoing.append((entry, pending))

    def _hand_over(self) -> None:
        outgoing, self._outgoing = self._outgoing, []
        for entry, pending in outgoing:
            self.journal.append(entry, pending)

    # -- measurements ----------------------------------------------------------------------------

    async def ingest(self, hosted: Hosted, robot: str, decoded: Decoded) -> bytes:
        """Take a batch in, and return its acknowledgement (JSON) once every query sees it.

        Raises ``Problem``: 404, 409, 422, or 500 where the map has stopped.
        """
        self.check_ready()
        data = encode_batch(decoded.batch)
        last = hosted.admitted.get(robot)
        if last is not None and decoded.sequence <= last.sequence:
            return await self._repeat(hosted, robot, decoded.sequence, last.sequence, digest(data))
        hosted.check_usable()
        hosted.check_next(robot, decoded)
        return await self._admit(hosted, robot, decoded, data)

    async def _admit(self, hosted: Hosted, robot: str, decoded: Decoded, data: bytes) -> bytes:
        batch = decoded.batch
        hosted.position += 1
        hosted.admitted[robot] = Admitted(decoded.sequence, float(batch.t[-1]))
        event = BatchEvent(hosted.key, hosted.position, robot, decoded.sequence, digest(data), data)
        pending = PendingBatch(hosted, event, batch, self._loop.create_future())
        hosted.in_flight[robot, decoded.sequence] = pending
        self._append(event, pending)
        acknowledgement = await pending.done
        self.counters.batches += 1
        self.counters.steps += batch.steps
        self.counters.observations += batch.observations
        return acknowledgement

    async def _repeat(self, hosted: Hosted, robot: str, sequence: int, last: int, content: bytes) -> bytes:
        """Return the first acknowledgement of a batch that came before."""
        pending = hosted.in_flight.get((robot, sequence))
        if pending is not None:
            _check_same(sequence, last, content, pending.event.digest)
            repeat: asyncio.Future[bytes] = self._loop.create_future()
            pending.repeats.append(repeat)
            return as_duplicate(await repeat)
        if sequence <= last - KEPT_ACKNOWLEDGEMENTS:
            raise Problem(
                409, "sequence-too-old",
                f"sequence: got {sequence}; acknowledgements are kept for the last "
                f"{KEPT_ACKNOWLEDGEMENTS} batches, up to {last}", expected=last + 1,
            )  # fmt: skip
        found = await asyncio.to_thread(self._look_up, hosted, robot, sequence)
        if hosted.deleted:
            raise not_found("map", hosted.id)
        if found is None or found[1] is None:
            raise hosted.stopped() if hosted.halted else not_found("batch", sequence)
        _check_same(sequence, last, content, found[0])
        self.counters.duplicates += 1
        return as_duplicate(found[1])

    def _look_up(self, hosted: Hosted, robot: str, sequence: int) -> tuple[bytes, bytes | None] | None:
        self.journal.flush()
        return self.journal.acknowledgement(hosted.key, robot, sequence)

    # -- solves ----------------------------------------------------------------------------------

    async def capture(self, hosted: Hosted) -> tuple[int, AtlasState]:
        """Capture a map's problem between two of its events."""
        done: asyncio.Future[tuple[int, AtlasState]] = self._loop.create_future()
        self._applier.put(Capture(hosted, done))
        return await done

    async def publish(self, hosted: Hosted, base: int, number: int, solved: Solved) -> Solve:
        """Send a solve through the journal into its map; raises ``Problem`` where that is gone."""
        hosted.check_usable()
        self.check_ready()
        solution = solved.solution
        hosted.position += 1
        event = SolveEvent(
            hosted.key, hosted.position, base, number, solved.problem_digest, pack("solve", solution.columns()),
            solved.seconds, solution.iterations, solution.cost,
        )  # fmt: skip
        pending = PendingSolve(hosted, event, solution, self._loop.create_future())
        self._append(event, pending)
        return await pending.done

    # -- what the applying thread tells ----------------------------------------------------------

    def _tell(self, results: Sequence[Result], group: Sequence[Pending], lost: Exception | None) -> None:
        self._loop.call_soon_threadsafe(self._told, results, group, lost)

    def _told(self, results: Sequence[Result], group: Sequence[Pending], lost: Exception | None) -> None:
        if lost is not None:
            self.unready = f"the journal cannot be written ({lost})"
        for done, result in results:
            _settle(done, result)
        touched = {pending.hosted: None for pending in group}
        for pending, (_, result) in zip(group, results, strict=False):  # a capture has a result and no entry
            if isinstance(pending, PendingBatch):
                event = pending.event
                pending.hosted.in_flight.pop((event.robot, event.sequence), None)
                for repeat in pending.repeats:
                    _settle(repeat, result)
        for hosted in touched:
            if hosted.runtime.solve_due and not hosted.deleted and not hosted.halted:
                self.solver.want(hosted)


def _settle(done: asyncio.Future[Any], result: Any) -> None:
    if done.cancelled():
        return
    if isinstance(result, Exception):
        done.set_exception(result)
    else:
        done.set_result(result)


def _check_same(sequence: int, last: int, content: bytes, first: bytes) -> None:
    if content != first:
        raise Problem(
            409, "sequence-conflict",
            f"sequence: batch {sequence} was taken in with other content", expected=last + 1,
        )  # fmt: skip
