"""The journal's contract: what happened to each map, durably and in one order."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol


class StoreError(Exception):
    """The store cannot be opened, or has stopped writing."""


@dataclass(frozen=True)
class MapRecord:
    """A map that exists: ``key`` is never used again, ``id`` is free once the map is deleted."""

    key: int
    id: str
    config: bytes


@dataclass(frozen=True)
class BatchEvent:
    """An admitted batch: ``data`` its encoded columns, ``digest`` of ``data``."""

    map: int
    position: int
    robot: str
    sequence: int
    digest: bytes
    data: bytes


@dataclass(frozen=True)
class SolveEvent:
    """A finished solve of the problem captured after event ``base``.

    ``data`` is what it found, ``problem_digest`` of what it was computed from; ``number`` counts
    the map's solves from 1.
    """

    map: int
    position: int
    base: int
    number: int
    problem_digest: bytes
    data: bytes
    seconds: float
    iterations: int
    cost: float


@dataclass(frozen=True)
class RobotEvent:
    """A robot is set apart from its map's defaults, before its first batch; ``data`` says how, as JSON."""

    map: int
    position: int
    robot: str
    data: bytes


@dataclass(frozen=True)
class CreateMap:
    """A map comes to exist; ``config`` is its configuration as JSON."""

    map: int
    id: str
    config: bytes


@dataclass(frozen=True)
class DeleteMap:
    """A map ceases to exist, with all that happened to it."""

    map: int


Event = BatchEvent | SolveEvent | RobotEvent
Entry = Event | CreateMap | DeleteMap


@dataclass(frozen=True)
class Derived:
    """What applying a batch gave: kept for reading back, and recomputed by a replay."""

    map: int
    robot: str
    sequence: int
    began: float
    ended: float
    acknowledgement: bytes
    track: bytes


@dataclass(frozen=True)
class Outcome:
    """What became of a group: its tokens in journal order, or the error that lost it."""

    tokens: Sequence[Any]
    error: Exception | None = None


@dataclass
class JournalStats:
    """Counts since the store was opened."""

    groups: int = 0
    entries: int = 0
    syncs: int = 0
    bytes: int = 0


class Journal(Protocol):
    """Appends are durable when the listener hears of them; concurrent ones share a sync.

    ``append``, ``derive`` and ``flush`` may be called from any thread. Appends are written in the
    order of the calls. The listener is called by the writing thread.
    """

    stats: JournalStats

    def start(self, listener: Callable[[Outcome], None]) -> None:
        """Begin to write; ``listener`` hears of each group once it is durable, or lost."""

    def append(self, entry: Entry, token: object) -> None:
        """Queue an entry; ``token`` comes back in an ``Outcome``."""

    def derive(self, derived: Sequence[Derived]) -> None:
        """Keep what was derived, along with a later group; it needs no sync of its own."""

    def flush(self) -> None:
        """Wait until everything queued or derived before this call is readable."""

    def close(self) -> None:
        """Write what is queued, and stop."""

    def maps(self) -> list[MapRecord]:
        """Return the maps that exist, oldest first."""

    def next_key(self) -> int:
        """Return a key above every key ever used."""

    def events(self, map_: int, after: int = 0) -> Iterator[tuple[Event, bool]]:
        """Yield the events of a map in order; the flag tells that what it derives is kept."""

    def solve_bases(self, map_: int) -> frozenset[int]:
        """Return the positions from which the map's solves were captured."""

    def acknowledgement(self, map_: int, robot: str, sequence: int) -> tuple[bytes, bytes | None] | None:
        """Return the digest and the acknowledgement of a batch, or None."""

    def tracks(self, map_: int, robot: str, began: float, ended: float) -> Iterator[bytes]:
        """Yield, in order, the tracks of a robot's batches that overlap a span of its time (s)."""
