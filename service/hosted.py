"""A map as the engine holds it, and what waits for its events."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from dataclasses import dataclass, field

from service.problems import Problem, not_found
from service.runtime import Runtime
from service.store.base import BatchEvent, RobotEvent, SolveEvent
from service.wire.columns import Decoded
from submaps.atlas.solution import Solution
from submaps.atlas.view import View
from submaps.config import MapConfig, Models, RobotConfig, Start
from submaps.measurements import Batch

KEPT_SOLVES = 1000


@dataclass(frozen=True)
class Solve:
    """A finished solve: its number, the version it published, what it took."""

    number: int
    map_version: int
    seconds: float
    iterations: int
    cost: float


@dataclass
class Admitted:
    """The last batch of a robot that was let in."""

    sequence: int
    t: float


@dataclass(eq=False)
class Hosted:
    """One map. The event loop changes everything but ``runtime`` and ``view``."""

    key: int
    id: str
    config: bytes
    core: MapConfig
    runtime: Runtime
    view: View
    position: int = 0
    own: dict[str, RobotConfig] = field(default_factory=dict)  # of the robots that are set apart
    admitted: dict[str, Admitted] = field(default_factory=dict)
    in_flight: dict[tuple[str, int], PendingBatch] = field(default_factory=dict)
    deleted: bool = False
    halted: str | None = None
    waiting: list[asyncio.Future[Solve]] = field(default_factory=list)
    begun: int = 0  # number of the last solve that was begun
    solves: OrderedDict[int, Solve | Problem] = field(default_factory=OrderedDict)

    def models(self, robot: str) -> Models:
        """Return what a robot's next batch is to be read with."""
        return self.own.get(robot, self.core)

    def check_usable(self) -> None:
        """Raise ``Problem`` where the map is gone (404) or has stopped (500)."""
        if self.deleted:
            raise not_found("map", self.id)
        if self.halted is not None:
            raise self.stopped()

    def stopped(self) -> Problem:
        """Return the problem of a map that takes nothing more in."""
        return Problem(
            500, "map-halted",
            f"Map {self.id!r} has stopped taking measurements in: {self.halted}. What was sent is "
            "kept, queries answer from before, and a restart with the fault mended resumes.",
        )  # fmt: skip

    def check_next(self, robot: str, decoded: Decoded) -> None:
        """Check a new batch against the last one admitted.

        Raises ``Problem``: 409 for a gap in the sequence, 422 for a time that does not follow.
        """
        last = self.admitted.get(robot)
        expected = last.sequence + 1 if last else 1
        if decoded.sequence != expected:
            raise Problem(
                409, "sequence-gap",
                f"sequence: got {decoded.sequence}, expected {expected}", expected=expected,
            )  # fmt: skip
        if last is None:
            return
        batch = decoded.batch
        first = float(batch.t[0])
        moves = batch.control_step.size > 0 and batch.control_step[0] == 0
        if first < last.t or (moves and first == last.t):
            raise _late(decoded.time_path(0), first, last)

    def check_new(self, robot: str, start: Start | None) -> None:
        """Check that a robot has sent nothing, and that its start's frame exists.

        Raises ``Problem``: 409, 404.
        """
        if robot in self.admitted:
            raise Problem(
                409, "robot-exists",
                f"Robot {robot!r} has sent measurements already: what sets it apart holds from its first batch on.",
            )  # fmt: skip
        if start is not None and start.frame != "map":
            number = int(start.frame.removeprefix("submap/"))
            if number >= self.view.submap_count:
                raise not_found("submap", number)

    def keep(self, number: int, outcome: Solve | Problem) -> None:
        """Remember what became of a solve, the last 1 000 of them."""
        self.solves[number] = outcome
        while len(self.solves) > KEPT_SOLVES:
            self.solves.popitem(last=False)


def _late(path: str, first: float, last: Admitted) -> Problem:
    message = (
        f"got {first}, expected a time after {last.t}, the end of batch {last.sequence} (equal only without a control)"
    )
    return Problem(422, "invalid-content", f"{path}: {message}", errors=[(path, message)])


@dataclass(eq=False)
class PendingBatch:
    """A batch on its way through journal and map; ``done`` gives its acknowledgement.

    So does each of ``repeats``, for whoever sent it again meanwhile: a future each, since one that
    stops waiting cancels its own.
    """

    hosted: Hosted
    event: BatchEvent
    batch: Batch
    done: asyncio.Future[bytes]
    repeats: list[asyncio.Future[bytes]] = field(default_factory=list)


@dataclass(eq=False)
class PendingRobot:
    """What sets a robot apart, on its way through journal and map."""

    hosted: Hosted
    event: RobotEvent
    own: RobotConfig
    done: asyncio.Future[None]


@dataclass(eq=False)
class PendingSolve:
    """A solve on its way through journal and map."""

    hosted: Hosted
    event: SolveEvent
    solution: Solution
    done: asyncio.Future[Solve]


@dataclass(eq=False)
class PendingChange:
    """A map being made or deleted."""

    hosted: Hosted
    done: asyncio.Future[None]


Pending = PendingBatch | PendingRobot | PendingSolve | PendingChange
