"""What an experiment is: repeated runs by seed, and an outcome with a table, a picture and a CSV."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

A = TypeVar("A")
B = TypeVar("B")


@dataclass(frozen=True)
class Table:
    """Rows under named columns; a number is rounded only where it is shown."""

    columns: tuple[str, ...]
    rows: tuple[tuple[object, ...], ...]


@dataclass(frozen=True)
class Outcome:
    """What came out.

    ``summary`` says it in a sentence or two, ``table`` is what is printed, ``figures`` the same as one
    object for programs, ``series`` what the CSV holds (every run or every point, not only averages).
    ``draw`` draws onto an empty figure. ``assumptions`` are the choices that the documents leave open.
    """

    summary: str
    table: Table
    figures: dict[str, Any]
    series: Table
    draw: Callable[[Figure], None]
    assumptions: tuple[str, ...] = ()
    size: tuple[float, float] = field(default=(10.0, 6.0))  # inches


class Runs(Protocol):
    """How many runs, of which seed, and the workers to share them out to."""

    count: int
    seed: int

    def generators(self, count: int) -> list[np.random.SeedSequence]:
        """Independent seeds, the same for the same ``seed``, whatever the number of workers."""
        ...

    def each(self, function: Callable[[A], B], items: Sequence[A], doing: str) -> list[B]:
        """``function`` of every item, in order, on every core, with progress shown under ``doing``.

        ``function`` and the items cross to worker processes: a function of a module, and plain data.
        """
        ...


@dataclass(frozen=True)
class Experiment:
    """One command's worth: ``submaps experiment NAME``; ``runs`` is how many by default."""

    name: str
    about: str
    runs: int
    run: Callable[[Runs], Outcome]
