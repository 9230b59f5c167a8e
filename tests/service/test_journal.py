"""The journal's contract; a further store joins the suite as one more entry of ``STORES``."""

from __future__ import annotations

import queue
import sqlite3
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from service.store.base import (
    BatchEvent,
    CreateMap,
    DeleteMap,
    Derived,
    Entry,
    Event,
    Journal,
    Outcome,
    RobotEvent,
    SolveEvent,
    StoreError,
)
from service.store.migrations import load_migrations
from service.store.sqlite import MOST_ROWS, SqliteJournal

STORES: dict[str, Callable[[Path], Journal]] = {"sqlite": SqliteJournal}


class Opened:
    """A journal that runs, and what its listener heard."""

    def __init__(self, make: Callable[[Path], Journal], path: Path) -> None:
        self.journal = make(path)
        self.heard: queue.Queue[Outcome] = queue.Queue()
        self.journal.start(self.heard.put)

    def write(self, *entries: Entry) -> None:
        """Append entries, and wait until they are durable."""
        for entry in entries:
            self.journal.append(entry, entry)
        wanted = len(entries)
        while wanted:
            outcome = self.heard.get(timeout=10)
            assert outcome.error is None
            wanted -= len(outcome.tokens)


@pytest.fixture(params=sorted(STORES))
def make(request: pytest.FixtureRequest) -> Callable[[Path], Journal]:
    return STORES[request.param]


@pytest.fixture
def opened(make: Callable[[Path], Journal], tmp_path: Path) -> Iterator[Opened]:
    one = Opened(make, tmp_path)
    yield one
    one.journal.close()


def batch(position: int, sequence: int, robot: str = "r1", map_: int = 1) -> BatchEvent:
    return BatchEvent(map_, position, robot, sequence, b"d%d" % position, b"x" * 1000 + b"%d" % position)


def solve(position: int, base: int, number: int = 1) -> SolveEvent:
    return SolveEvent(1, position, base, number, b"p", b"columns", 0.25, 7, 12.5)


def derived(sequence: int, robot: str = "r1", map_: int = 1) -> Derived:
    return Derived(map_, robot, sequence, float(sequence), sequence + 0.5, b"ack%d" % sequence, b"track%d" % sequence)


def robot(position: int, name: str = "r1", map_: int = 1) -> RobotEvent:
    return RobotEvent(map_, position, name, b'{"position": %d}' % position)


MAP = CreateMap(1, "park", b"{}")


def test_events_come_back_in_one_order(opened: Opened) -> None:
    events: list[Event] = [
        robot(1, "r2"), batch(2, 1), robot(3, "r2"), batch(4, 1, "r2"), solve(5, 2), batch(6, 2), robot(7, "r3"),
        solve(8, 6, 2), batch(9, 2, "r2"),
    ]  # fmt: skip
    opened.write(MAP, CreateMap(2, "yard", b"[]"), *events, robot(1, "r9", 2))
    assert [event for event, _ in opened.journal.events(1)] == events
    assert [event for event, _ in opened.journal.events(1, after=5)] == events[5:]
    assert [event for event, _ in opened.journal.events(2)] == [robot(1, "r9", 2)]
    assert opened.journal.solve_bases(1) == {2, 6}


def test_what_was_heard_of_is_there_after_opening_again(make: Callable[[Path], Journal], tmp_path: Path) -> None:
    first = Opened(make, tmp_path)
    first.write(MAP, CreateMap(2, "yard", b"[]"), batch(1, 1))
    first.journal.close()
    again = Opened(make, tmp_path)
    assert [(m.key, m.id, m.config) for m in again.journal.maps()] == [(1, "park", b"{}"), (2, "yard", b"[]")]
    assert [event for event, _ in again.journal.events(1)] == [batch(1, 1)]
    again.journal.close()


def test_what_is_derived_is_readable_after_a_flush_and_is_flagged(opened: Opened) -> None:
    opened.write(MAP, batch(1, 1), batch(2, 2))
    assert opened.journal.acknowledgement(1, "r1", 1) == (b"d1", None)
    opened.journal.derive([derived(1)])
    opened.journal.flush()
    assert opened.journal.acknowledgement(1, "r1", 1) == (b"d1", b"ack1")
    assert opened.journal.acknowledgement(1, "r1", 9) is None
    assert [kept for _, kept in opened.journal.events(1)] == [True, False]


def test_what_is_derived_needs_no_sync_of_its_own(opened: Opened) -> None:
    opened.write(MAP, batch(1, 1))
    before = opened.journal.stats.syncs
    opened.journal.derive([derived(1)])
    opened.write(batch(2, 2))
    assert opened.journal.stats.syncs == before + 1
    assert opened.journal.acknowledgement(1, "r1", 1) == (b"d1", b"ack1")


def test_what_is_derived_is_written_even_if_nothing_follows(make: Callable[[Path], Journal], tmp_path: Path) -> None:
    first = Opened(make, tmp_path)
    first.write(MAP, batch(1, 1))
    first.journal.derive([derived(1)])
    first.journal.close()
    again = Opened(make, tmp_path)
    assert [kept for _, kept in again.journal.events(1)] == [True]
    again.journal.close()


def test_tracks_come_in_order_within_a_span(opened: Opened) -> None:
    opened.write(MAP, batch(1, 1), batch(2, 1, "r2"), batch(3, 2), batch(4, 3))
    opened.journal.derive([derived(1), derived(1, "r2"), derived(2), derived(3)])
    opened.journal.flush()
    inf = np.inf
    assert list(opened.journal.tracks(1, "r1", -inf, inf)) == [b"track1", b"track2", b"track3"]
    assert list(opened.journal.tracks(1, "r1", 1.5, 2.0)) == [b"track1", b"track2"]
    assert list(opened.journal.tracks(1, "r1", 4.0, inf)) == []


def test_a_deleted_map_frees_its_id_and_never_its_key(opened: Opened) -> None:
    opened.write(MAP, batch(1, 1), DeleteMap(1), CreateMap(2, "park", b"{}"))
    opened.journal.derive([derived(1)])
    opened.journal.flush()
    assert [(m.key, m.id) for m in opened.journal.maps()] == [(2, "park")]
    assert list(opened.journal.tracks(1, "r1", -np.inf, np.inf)) == []
    opened.write(DeleteMap(2))
    assert opened.journal.next_key() == 3


def test_many_are_kept_at_once_but_those_of_a_deleted_map(opened: Opened) -> None:
    """Also where their number is no multiple of what one statement takes."""
    many = range(1, 2 * MOST_ROWS + 8)
    opened.write(MAP, CreateMap(2, "yard", b"{}"), *(batch(i, i, map_=m) for i in many for m in (1, 2)), DeleteMap(2))
    opened.journal.derive([derived(i, map_=m) for i in many for m in (1, 2)])
    opened.journal.flush()
    assert [event for event, kept in opened.journal.events(1) if kept] == [batch(i, i) for i in many]
    assert list(opened.journal.tracks(1, "r1", -np.inf, np.inf)) == [derived(i).track for i in many]
    assert list(opened.journal.tracks(2, "r1", -np.inf, np.inf)) == []


def test_a_deleted_map_is_cleared_away(opened: Opened) -> None:
    opened.write(MAP, *(batch(i, i) for i in range(1, 120)), *(robot(i) for i in range(120, 180)), DeleteMap(1))
    for _ in range(200):
        if not list(opened.journal.events(1)):
            break
        threading.Event().wait(0.05)
    assert list(opened.journal.events(1)) == []


def test_appends_that_come_together_share_a_sync(opened: Opened) -> None:
    opened.write(MAP)
    before = opened.journal.stats.syncs
    opened.write(*(batch(i, i) for i in range(1, 501)))
    assert opened.journal.stats.syncs - before <= 250


def test_nothing_is_written_after_an_entry_was_lost(opened: Opened) -> None:
    opened.write(MAP, batch(1, 1))
    for entry in (batch(1, 2), batch(3, 3)):  # the first takes a position that is taken
        opened.journal.append(entry, entry)
        outcome = opened.heard.get(timeout=10)
        assert outcome.error is not None
        assert entry in outcome.tokens
    assert [event for event, _ in opened.journal.events(1)] == [batch(1, 1)]
    with pytest.raises(StoreError):
        opened.journal.flush()


def test_a_second_server_is_refused(make: Callable[[Path], Journal], opened: Opened, tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="in use"):
        make(tmp_path)


def test_a_journal_of_an_earlier_version_is_brought_up_to_date(tmp_path: Path) -> None:
    version, first = load_migrations()[0]
    connection = sqlite3.connect(tmp_path / "journal.sqlite")
    connection.executescript(first)
    connection.execute("CREATE TABLE migration (version INTEGER PRIMARY KEY)")
    connection.execute("INSERT INTO migration VALUES (?)", (version,))
    connection.execute("INSERT INTO map (key, id, config) VALUES (1, 'park', '{}')")
    connection.execute("INSERT INTO batch VALUES (1, 1, 'r1', 1, ?, ?)", (batch(1, 1).digest, batch(1, 1).data))
    connection.commit()
    connection.close()
    opened = Opened(SqliteJournal, tmp_path)
    opened.write(robot(2, "r2"), batch(3, 1, "r2"))
    assert [event for event, _ in opened.journal.events(1)] == [batch(1, 1), robot(2, "r2"), batch(3, 1, "r2")]
    opened.journal.close()


def test_a_journal_of_a_later_version_is_refused(tmp_path: Path) -> None:
    SqliteJournal(tmp_path).close()
    connection = sqlite3.connect(tmp_path / "journal.sqlite")
    connection.execute("INSERT INTO migration VALUES (9999)")
    connection.commit()
    connection.close()
    with pytest.raises(StoreError, match="9999"):
        SqliteJournal(tmp_path)


def test_a_file_that_is_no_journal_is_refused(tmp_path: Path) -> None:
    (tmp_path / "journal.sqlite").write_bytes(b"not a database" * 100)
    with pytest.raises(StoreError):
        SqliteJournal(tmp_path)
