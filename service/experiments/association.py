"""``association``: three ways to find out which landmark a reading is of, and what one mistake costs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from service.experiments import association_world as world
from service.experiments.association_runs import (
    FORGOTTEN_AFTER,
    GATES,
    Driven,
    Example,
    Mistake,
    by_method,
    example,
    likeliest_mistake,
    run,
    with_mistake,
)
from service.experiments.base import Experiment, Outcome, Runs, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

METHODS = ("known", "greedy", "assignment", "joint")
NOISES, CLUTTERS = (0.5, 1.0, 1.5, 2.0, 3.0), (0.0, 1.0, 2.0, 4.0, 8.0)
CELLS = tuple((noise, 0.0) for noise in NOISES) + tuple((1.0, clutter) for clutter in CLUTTERS[1:])
SPOILT = 2.0  # times the map error that the same drive may have
MISTAKE_NOISE, SHOWN_NOISE = 2.0, 3.0  # at which the likeliest mistake lies within its gate; at which one shows well
BEFORE, AFTER = 20, 60  # steps around the mistake that are kept of the NEES
# Whether the mistake is made, and how it goes on after.
COURSES = {
    "right, then joint": (False, "joint"), "wrong, then known": (True, "known"), "wrong, then joint": (True, "joint"),
}  # fmt: skip

ASSUMPTIONS = (
    "the lecture names no gates: a match has to lie within the chi-square probability "
    f"{GATES.match}, a new landmark beyond {GATES.new} from all others; in between a reading is set aside",
    f"the world: {world.LANDMARKS} landmarks at least {world.APART} m apart along a circle of {world.RADIUS:.0f} m, "
    f"{world.LAPS} laps, seen within {world.SENSOR_RANGE:.0f} m with probability {world.DETECTED}",
    "noise 1 is 0.06 m, 0.03 m and 1.5 degrees of odometry a metre, 0.05 m and 0.7 degrees of a reading; "
    "the filter knows it",
    "clutter is Poisson, spread evenly over the disc that is seen",
    f"a landmark that has been seen in one scan only is forgotten after {FORGOTTEN_AFTER} scans without it",
    "among hypotheses with as many pairs joint compatibility takes the likeliest, where the paper takes the least d^2",
)


@dataclass(frozen=True)
class Task:
    """One drive, to be gone through by every method."""

    number: int
    seed: np.random.SeedSequence
    noise: float
    clutter: float


@dataclass(frozen=True)
class Result:
    """What one method made of one drive; shares are of readings of landmarks, ``taken`` of clutter."""

    run: int
    noise: float
    clutter: float
    method: str
    correct: float
    wrong: float
    missed: float
    taken: float
    landmarks: int
    map_rmse: float
    spoilt: bool
    nees: float  # of the pose, per degree of freedom, median over the second half
    microseconds: float  # of the median step: distances and choice
    cut_short: int


@dataclass(frozen=True)
class Course:
    """How a drive went on: error and NEES of the map at its end, NEES of the pose around the mistake."""

    map_rmse: float
    map_nees: float
    pose_nees: Floats
    wrong: int


@dataclass(frozen=True)
class Blunder:
    """A wrong match in a drive that was known until then, and each of ``COURSES`` from it."""

    run: int
    mistake: Mistake
    courses: dict[str, Course]


def drive_all(task: Task) -> list[Result]:
    """Go through one drive with every method."""
    drive = world.simulate(task.seed, task.noise, task.clutter)
    driven = {name: run(drive, by_method(name)) for name in METHODS}
    reference = driven["known"].map_rmse
    return [_result(task, name, d, reference) for name, d in driven.items()]


def _result(task: Task, method: str, d: Driven, reference: float) -> Result:
    t = d.tally
    seen = max(t.correct + t.wrong + t.missed, 1)
    return Result(
        run=task.number, noise=task.noise, clutter=task.clutter, method=method, correct=t.correct / seen,
        wrong=t.wrong / seen, missed=t.missed / seen, taken=t.taken / max(t.clutter, 1),
        landmarks=int(np.count_nonzero(d.sightings > 1)), map_rmse=d.map_rmse, spoilt=d.map_rmse > SPOILT * reference,
        nees=float(np.median(d.nees[d.nees.size // 2 :])), microseconds=1e6 * float(np.median(t.seconds)),
        cut_short=t.cut_short,
    )  # fmt: skip


def blunder(task: Task) -> tuple[Blunder, Example | None]:
    """Make the likeliest wrong match of a drive; and find a scan of a noisier one to show."""
    drive = world.simulate(task.seed, task.noise, task.clutter)
    mistake = likeliest_mistake(drive, BEFORE + 1, len(drive.scans) - AFTER)
    around = slice(mistake.step - 1 - BEFORE, mistake.step - 1 + AFTER)  # the first step has no NEES
    courses = {}
    for name, (made, after) in COURSES.items():
        d = with_mistake(drive, mistake, made=made, after=after)
        courses[name] = Course(d.map_rmse, d.map_nees, d.nees[around], d.tally.wrong)
    return Blunder(task.number, mistake, courses), example(world.simulate(task.seed, SHOWN_NOISE, 1.0))


def experiment(runs: Runs) -> Outcome:
    """Run every cell, and the blunders."""
    seeds = list(enumerate(runs.generators(runs.count)))
    tasks = [Task(k, seed, noise, clutter) for k, seed in seeds for noise, clutter in CELLS]
    results = [one for some in runs.each(drive_all, tasks, "drives") for one in some]
    pairs = runs.each(blunder, [Task(k, seed, MISTAKE_NOISE, 0.0) for k, seed in seeds], "one wrong match")
    blunders = [one for one, _ in pairs]
    examples = [one for _, one in pairs if one is not None]
    shown = max(examples, key=lambda one: one.mistakes, default=None)
    cells = [_cell(results, noise, clutter, method) for noise, clutter in CELLS for method in METHODS]
    costs = _costs(blunders)
    return Outcome(
        summary=_summary(cells, costs), table=_table(cells), figures={"cells": cells, "one_wrong_match": costs},
        series=_series(results, blunders),
        draw=partial(_draw, cells, blunders, shown),
        assumptions=ASSUMPTIONS, size=(12.0, 8.2),
    )  # fmt: skip


def _draw(cells: Sequence[dict[str, Any]], blunders: Sequence[Blunder], shown: Example | None, figure: Figure) -> None:
    from service.experiments.association_picture import draw  # only here: an extra

    draw(figure, cells, blunders, BEFORE, shown)


def _cell(results: Sequence[Result], noise: float, clutter: float, method: str) -> dict[str, Any]:
    """Means over the runs of a cell; medians of what has a long tail."""
    some = [r for r in results if (r.noise, r.clutter, r.method) == (noise, clutter, method)]

    def mean(name: str) -> float:
        return float(np.mean([getattr(r, name) for r in some]))

    return {
        "noise": noise, "clutter": clutter, "method": method,
        **{name: mean(name) for name in ("correct", "wrong", "missed", "taken", "spoilt", "landmarks")},
        "map_rmse": float(np.median([r.map_rmse for r in some])),
        "pose_nees": float(np.median([r.nees for r in some])),
        "microseconds": mean("microseconds"), "cut_short": sum(r.cut_short for r in some),
    }  # fmt: skip


def _costs(blunders: Sequence[Blunder]) -> dict[str, Any]:
    """Medians over the runs."""

    def course(name: str) -> dict[str, float]:
        some = [b.courses[name] for b in blunders]
        best = [min(c.map_rmse for c in b.courses.values()) for b in blunders]
        return {
            "map_rmse": _median([c.map_rmse for c in some]), "map_nees": _median([c.map_nees for c in some]),
            "pose_nees_at_once": _median([c.pose_nees[BEFORE] for c in some]),
            "pose_nees_after_20": _median([c.pose_nees[BEFORE + 20] for c in some]),
            "wrong": _median([c.wrong for c in some]),
            "spoilt": float(np.mean([c.map_rmse > SPOILT * least for c, least in zip(some, best, strict=True)])),
        }  # fmt: skip

    return {
        "runs": len(blunders), "step": _median([b.mistake.step for b in blunders]),
        "squared_distance": _median([b.mistake.squared for b in blunders]),
        "apart": _median([b.mistake.apart for b in blunders]), "courses": {name: course(name) for name in COURSES},
    }  # fmt: skip


def _median(values: Sequence[float]) -> float:
    return float(np.median(values))


def _summary(cells: Sequence[dict[str, Any]], costs: dict[str, Any]) -> str:
    worst = {c["method"]: c for c in cells if c["clutter"] == CLUTTERS[-1]}
    right, mended, ruined = (costs["courses"][name] for name in COURSES)
    return (
        f"With {CLUTTERS[-1]:g} false readings a scan, {100 * worst['greedy']['wrong']:.1f} % of the readings go to a "
        f"wrong landmark by the greedy method, {100 * worst['assignment']['wrong']:.1f} % by assignment, "
        f"{100 * worst['joint']['wrong']:.1f} % by joint compatibility. One wrong match as the loop closes takes the "
        f"pose's NEES per degree of freedom from {right['pose_nees_at_once']:.1f} to "
        f"{mended['pose_nees_at_once']:.0f}; if all that follow are right, the map's error ends at "
        f"{mended['map_rmse']:.2f} m (without it {right['map_rmse']:.2f} m), but if they have to be found from there, "
        f"at {ruined['map_rmse']:.1f} m, with {ruined['wrong'] - 1:.0f} more of them wrong."
    )


def _table(cells: Sequence[dict[str, Any]]) -> Table:
    columns = ("noise / clutter", "method", "right %", "wrong %", "missed %", "spoilt %", "map m", "µs a step")
    rows = tuple(
        (f"{c['noise']:g} / {c['clutter']:g}", c["method"],
         *(100.0 * c[name] for name in ("correct", "wrong", "missed", "spoilt")), c["map_rmse"], c["microseconds"])
        for c in cells
    )  # fmt: skip
    return Table(columns, rows)


def _series(results: Sequence[Result], blunders: Sequence[Blunder]) -> Table:
    """Every run of every method; the blunders as methods of their own."""
    names = ("run", "noise", "clutter", "method", "correct", "wrong", "missed", "taken", "landmarks", "map_rmse",
             "spoilt", "nees", "microseconds", "cut_short")  # fmt: skip
    rows: list[tuple[object, ...]] = [tuple(getattr(r, name) for name in names) for r in results]
    for b in blunders:
        best = min(c.map_rmse for c in b.courses.values())
        rows += [
            (b.run, MISTAKE_NOISE, 0.0, name, *[""] * 5, c.map_rmse, c.map_rmse > SPOILT * best,
             float(c.pose_nees[BEFORE]), "", "")
            for name, c in b.courses.items()
        ]  # fmt: skip
    return Table(names, tuple(rows))


EXPERIMENT = Experiment("association", __doc__.split(": ", 1)[1], 20, experiment)
