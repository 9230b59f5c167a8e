"""The journal in one SQLite file: write-ahead log, one writing thread, group commit."""

from __future__ import annotations

import heapq
import logging
import re
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from functools import cache
from itertools import chain, groupby
from pathlib import Path
from typing import Any

from service.store.base import (
    BatchEvent,
    CreateMap,
    DeleteMap,
    Derived,
    Entry,
    Event,
    JournalStats,
    MapRecord,
    Outcome,
    RobotEvent,
    SolveEvent,
    StoreError,
)
from service.store.migrations import load_statements, migrate

SQL = load_statements()
IDLE_SECONDS = 0.5  # what was derived waits this long, or up to twice, for a group to go along with
CLEAR_SECONDS = 0.02  # and a deleted map's next rows this long
MOST_ROWS = 32  # inserted by one statement
CLEAR_ROWS = 50  # rows of a deleted map cleared away at a time
CHECKPOINT_BYTES = 16 * 2**20  # written to the log (about) before it is copied into the file
ENTRY_BYTES = 8 * 1024  # of the log that an entry takes beside its data: pages of tables and indices

_ROW = re.compile(r"\(\?[?, ]*\)")
_INSERTS = {BatchEvent: "append_batch", SolveEvent: "append_solve", RobotEvent: "append_robot", CreateMap: "create_map"}

log = logging.getLogger(__name__)


class SqliteJournal:
    """A ``Journal`` in ``directory``; one process at a time may have it open.

    Raises ``StoreError`` where the directory is in use or cannot be written.
    """

    def __init__(self, directory: Path) -> None:
        try:
            directory.mkdir(parents=True, exist_ok=True)
            self._path = directory / "journal.sqlite"
            self._lock_file = _hold(directory / "lock.sqlite")
            self._writer = _connect(self._path)
            self._writer.execute("PRAGMA journal_mode=WAL")
            self._writer.execute("PRAGMA wal_autocheckpoint=0")
            migrate(self._writer)
        except (OSError, sqlite3.Error) as error:
            raise StoreError(f"cannot open the journal in {directory}: {error}") from error
        self.stats = JournalStats()
        self._condition = threading.Condition()
        self._queue: list[tuple[Entry, object]] = []
        self._derived: list[Derived] = []
        self._derived_at = 0.0  # when the first of them came
        self._asked = 0  # flushes asked for, and the last of them that was done
        self._flushed = 0
        self._closing = False
        self._error: Exception | None = None
        self._clearing = True
        self._logged = 0
        self._thread: threading.Thread | None = None

    # -- writing ---------------------------------------------------------------------------------

    def start(self, listener: Callable[[Outcome], None]) -> None:
        """Begin to write."""
        self._thread = threading.Thread(target=self._run, args=(listener,), name="journal")
        self._thread.start()

    def append(self, entry: Entry, token: object) -> None:
        """Queue an entry."""
        with self._condition:
            self._queue.append((entry, token))
            self._condition.notify_all()

    def derive(self, derived: Sequence[Derived]) -> None:
        """Keep what was derived with the next group, or before long."""
        with self._condition:
            if not self._derived:
                self._derived_at = time.monotonic()
            self._derived += derived  # nobody is woken for it

    def flush(self) -> None:
        """Wait until everything queued or derived before is readable."""
        with self._condition:
            self._asked += 1
            mine = self._asked
            self._condition.notify_all()
            self._condition.wait_for(lambda: self._flushed >= mine or self._error is not None)
        if self._error is not None:
            raise StoreError(f"the journal has stopped: {self._error}")

    def close(self) -> None:
        """Write what is queued, and stop."""
        with self._condition:
            self._closing = True
            self._condition.notify_all()
        if self._thread is not None:
            self._thread.join()
        self._writer.close()
        self._lock_file.close()

    def _run(self, listener: Callable[[Outcome], None]) -> None:
        closing_now = False
        while not closing_now:
            with self._condition:
                self._wait_for_work()
                closing_now = self._closing
                asked = self._asked
                entries, self._queue = self._queue, []
                derived, self._derived = self._derived, []
            self._write_group(entries, derived, listener)
            with self._condition:
                self._flushed = asked
                self._condition.notify_all()
            if self._error is None:
                self._tidy(last=closing_now)

    def _wait_for_work(self) -> None:
        def urgent() -> bool:
            return bool(self._queue) or self._closing or self._asked > self._flushed

        pause = CLEAR_SECONDS if self._clearing else IDLE_SECONDS
        while not self._condition.wait_for(urgent, timeout=pause) and not self._clearing:
            if self._derived and time.monotonic() - self._derived_at >= IDLE_SECONDS:
                break

    def _write_group(
        self,
        entries: list[tuple[Entry, object]],
        derived: list[Derived],
        listener: Callable[[Outcome], None],
    ) -> None:
        tokens = [token for _, token in entries]
        try:
            if self._error is not None:
                raise StoreError(f"the journal has stopped: {self._error}")
            if entries or derived:
                self._commit([entry for entry, _ in entries], derived)
        except Exception as error:
            # Whatever it is, nobody may wait for ever. Nothing after a lost entry
            # may be kept: positions and sequences would have a hole.
            log.critical("the journal has stopped writing: %s", error)
            self._error = self._error or error
            listener(Outcome(tokens, error))
            return
        if entries:
            listener(Outcome(tokens))

    def _commit(self, entries: list[Entry], derived: list[Derived]) -> None:
        self._writer.execute("BEGIN IMMEDIATE")
        try:
            for type_, run in groupby(entries, type):
                self._insert(type_, list(run))
            self._insert_rows("derive", derived)
            for one in derived:
                self._written(one.track)
            self._writer.execute("COMMIT")
        except BaseException:
            if self._writer.in_transaction:
                self._writer.execute("ROLLBACK")
            raise
        self._logged += ENTRY_BYTES * (len(entries) + len(derived))
        self.stats.groups += 1
        self.stats.entries += len(entries)
        self.stats.syncs += 1  # synchronous=FULL: each commit syncs the log once

    def _insert(self, type_: type[Entry], entries: list[Any]) -> None:
        """Insert entries of one type."""
        if type_ is DeleteMap:
            self._writer.executemany(SQL["mark_deleted"], [(entry.map,) for entry in entries])
            self._clearing = True
            return
        self._insert_rows(_INSERTS[type_], entries)
        if type_ is not CreateMap:
            for entry in entries:
                self._written(entry.data)

    def _insert_rows(self, statement: str, rows: Sequence[Entry | Derived]) -> None:
        # Many rows a statement: after each statement this thread has to wait for the interpreter.
        at = 0
        while at < len(rows):
            some = rows[at : at + min(MOST_ROWS, 1 << (len(rows) - at).bit_length() - 1)]
            values = tuple(chain.from_iterable(vars(row).values() for row in some))
            self._writer.execute(_for_rows(statement, len(some)), values)
            at += len(some)

    def _written(self, data: bytes) -> None:
        self.stats.bytes += len(data)
        self._logged += len(data)

    def _tidy(self, *, last: bool) -> None:
        """Off the path of any client: shorten the log, clear away a part of a deleted map."""
        try:
            if self._clearing and not last:
                self._clear_some()
            if last or self._logged > CHECKPOINT_BYTES:
                self._writer.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchall()
                self._logged = 0
                self.stats.syncs += 2  # the log, then the file
        except sqlite3.Error as error:
            if self._writer.in_transaction:
                self._writer.execute("ROLLBACK")
            log.warning("tidying the journal failed, and will be tried again: %s", error)

    def _clear_some(self) -> None:
        row = self._writer.execute(SQL["one_deleted"]).fetchone()
        if row is None:
            self._clearing = False
            return
        self._writer.execute("BEGIN IMMEDIATE")
        cleared = sum(
            self._writer.execute(SQL[name], (row[0], CLEAR_ROWS)).rowcount
            for name in ("clear_derived", "clear_solve", "clear_robot", "clear_batch")
        )
        if not cleared:
            self._writer.execute(SQL["clear_map"], row)
        self._writer.execute("COMMIT")
        self.stats.syncs += 1

    # -- reading ---------------------------------------------------------------------------------

    def maps(self) -> list[MapRecord]:
        """Return the maps that exist, oldest first."""
        with self._reading() as reader:
            return [MapRecord(*row) for row in reader.execute(SQL["maps"])]

    def next_key(self) -> int:
        """Return a key above every key ever used."""
        with self._reading() as reader:
            return int(reader.execute(SQL["last_key"]).fetchone()[0]) + 1

    def events(self, map_: int, after: int = 0) -> Iterator[tuple[Event, bool]]:
        """Yield the events of a map in order; the flag tells that what it derives is kept."""
        with self._reading() as reader:
            batches: Iterator[tuple[Event, bool]] = (
                (BatchEvent(*row[:6]), bool(row[6])) for row in reader.execute(SQL["batches"], (map_, after))
            )
            solves: Iterator[tuple[Event, bool]] = (
                (SolveEvent(*row), True) for row in reader.execute(SQL["solves"], (map_, after))
            )
            robots: Iterator[tuple[Event, bool]] = (
                (RobotEvent(*row), True) for row in reader.execute(SQL["robots"], (map_, after))
            )
            yield from heapq.merge(batches, solves, robots, key=lambda pair: pair[0].position)

    def solve_bases(self, map_: int) -> frozenset[int]:
        """Return the positions from which the map's solves were captured."""
        with self._reading() as reader:
            return frozenset(row[0] for row in reader.execute(SQL["solve_bases"], (map_,)))

    def acknowledgement(self, map_: int, robot: str, sequence: int) -> tuple[bytes, bytes | None] | None:
        """Return the digest and the acknowledgement of a batch, or None."""
        with self._reading() as reader:
            row = reader.execute(SQL["acknowledgement"], (map_, robot, sequence)).fetchone()
        return None if row is None else (row[0], row[1])

    def tracks(self, map_: int, robot: str, began: float, ended: float) -> Iterator[bytes]:
        """Yield, in order, the tracks of a robot's batches that overlap a span of its time (s)."""
        with self._reading() as reader:
            for (track,) in reader.execute(SQL["tracks"], (map_, robot, began, ended)):
                yield track

    @contextmanager
    def _reading(self) -> Iterator[sqlite3.Connection]:
        # A connection each: a reader sees one state of the file, and never waits for the writer.
        with closing(_connect(self._path)) as reader:
            reader.execute("PRAGMA query_only=ON")
            yield reader


@cache
def _for_rows(name: str, rows: int) -> str:
    """Return a statement that has one row of parameters for so many rows."""
    return _ROW.sub(lambda row: ", ".join([row[0]] * rows), SQL[name])


def _connect(path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
    connection.execute("PRAGMA synchronous=FULL")
    connection.execute("PRAGMA foreign_keys=ON")
    return connection


def _hold(path: Path) -> sqlite3.Connection:
    """Return a connection whose lock on ``path`` ends with the process, however it ends."""
    connection = sqlite3.connect(path, isolation_level=None, timeout=0, check_same_thread=False)
    try:
        connection.execute("BEGIN EXCLUSIVE")
    except sqlite3.OperationalError as error:
        connection.close()
        raise StoreError(f"{path.parent} is in use by another server ({error})") from error
    return connection
