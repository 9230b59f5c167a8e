"""One map as a function of its events: no I/O, no clock, one thread at a time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from submaps.atlas.solution import Solution
from submaps.atlas.state import AtlasState
from submaps.atlas.view import View
from submaps.config import MapConfig, RobotConfig
from submaps.errors import DigestMismatch
from submaps.mapper import Mapper
from submaps.measurements import Batch, Report


@dataclass(frozen=True)
class Measured:
    """A robot sent a batch."""

    position: int
    robot: str
    batch: Batch


@dataclass(frozen=True)
class Configured:
    """A robot was set apart from the map's defaults, before its first batch."""

    position: int
    robot: str
    own: RobotConfig


@dataclass(frozen=True)
class Solved:
    """A solve of the problem captured after event ``base`` found ``columns``.

    ``solution`` is what was solved, where it was solved here: the same values, with the covariances
    that were derived from them already.
    """

    position: int
    base: int
    problem_digest: bytes
    columns: Mapping[str, NDArray[Any]]
    solution: Solution | None = None


MapEvent = Measured | Configured | Solved


class Runtime:
    """A map that is brought forward event by event.

    ``bases`` are the positions from which the solves to come were captured: a replay has to capture
    there too. Live, ``capture`` is called instead. Between a capture and the event of its solve no
    other may be captured.
    """

    def __init__(self, config: MapConfig, bases: frozenset[int] = frozenset()) -> None:
        self.position = 0
        self._mapper = Mapper(config)
        self._bases = bases
        self._captured: tuple[int, AtlasState] | None = None
        self.version = self._mapper.view().version
        self._after(0)

    @property
    def solve_due(self) -> bool:
        """Whether enough has happened for the atlas to be solved again."""
        return self._mapper.solve_due

    def apply(self, event: MapEvent) -> Report | None:
        """Bring the map forward by one event; a batch gives a report.

        Raises ``DigestMismatch`` where a solve was computed from another state than this one's.
        """
        report = None
        if isinstance(event, Measured):
            report = self._mapper.apply(event.robot, event.batch)
        elif isinstance(event, Configured):
            self._mapper.configure(event.robot, event.own)
        else:
            self._install(event)
        self._after(event.position)
        return report

    def capture(self) -> tuple[int, AtlasState]:
        """Return the present position and what a solve needs to know of it."""
        self._captured = (self.position, self._mapper.problem())
        return self._captured

    def view(self) -> View:
        """Return what queries see, as of the last event."""
        return self._mapper.view()

    def _after(self, position: int) -> None:
        self.position = position
        if position in self._bases:
            self.capture()

    def _install(self, event: Solved) -> None:
        base, problem = self._captured or (None, None)
        if problem is None or base != event.base:
            raise DigestMismatch(f"the solve at {event.position} started from {event.base}, but {base} was captured")
        if problem.digest() != event.problem_digest:
            raise DigestMismatch(f"the solve at {event.position} was computed from another state of {event.base}")
        self._mapper.install(event.solution or Solution.from_columns(problem, event.columns))
        self._captured = None
        self.version = self.view().version
