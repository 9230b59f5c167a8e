"""``phantom``: a vehicle that stands still, its heading uncertain by 5°, looks at landmarks again and again."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from service.experiments.base import Experiment, Outcome, Runs, Table
from service.experiments.rows import chosen
from submaps.consistency import average_bounds
from submaps.reference.moments import Exact, Rule, second_order
from submaps.reference.phantom import Reading, Still, heading_gain, measured_gain, surroundings

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

SIGMA_HEADING = math.radians(5.0)
SIGMA = (0.1, math.radians(1.0))  # m, rad: of a reading
LANDMARKS, SCANS, SCANS_BY_MOMENTS, MOST_BY_MOMENTS = 20, 10_000, 1_000, 4
NOISES = (0.1, 1.0, 10.0)
ANALYSED = Reading(8.0, 0.0, *SIGMA, SIGMA_HEADING)
_RULES: dict[str, Rule] = {"second order": second_order, "exact moments": Exact(7)}
_POINTS = 60  # of a run's curve


@dataclass(frozen=True)
class Job:
    """One run of one filter."""

    filter: str
    noise: float
    seed: np.random.SeedSequence


@dataclass(frozen=True)
class Watched:
    """Scans (k,) after which the heading's σ (k,) rad was noted, and the normalised error squared at the end."""

    scans: NDArray[np.int64]
    sigma: Floats
    nees: float


def watch(job: Job) -> Watched:
    """Stand still and look."""
    rng = np.random.default_rng(job.seed)
    still = Still(surroundings(rng, LANDMARKS), SIGMA_HEADING, (job.noise * SIGMA[0], job.noise * SIGMA[1]))
    truth = SIGMA_HEADING * rng.normal()
    if job.filter in _RULES:
        heading, variance = still.watch_by_moments(SCANS_BY_MOMENTS, rng, _RULES[job.filter])
    else:
        heading, variance = still.watch(SCANS, rng, invariant=job.filter == "invariant EKF")
    noted = np.unique(np.geomspace(1, len(variance), _POINTS).astype(np.int64))
    error = heading[-1] - truth
    return Watched(noted, np.sqrt(variance[noted - 1]), float(error * error / variance[-1]))


Groups = dict[tuple[str, float], list[Watched]]  # by filter and noise


def run(runs: Runs) -> Outcome:
    """Every filter over the same worlds and readings, at three magnitudes of noise; and the gain's closed form."""
    seeds = runs.generators(runs.count)
    jobs = [Job(name, 1.0, seed) for name in _RULES for seed in seeds[:MOST_BY_MOMENTS]]
    jobs += [Job(f"{name} EKF", noise, s) for name in ("standard", "invariant") for noise in NOISES for s in seeds]
    watched = runs.each(watch, jobs, "runs")
    groups: Groups = {}
    for job, found in zip(jobs, watched, strict=True):
        groups.setdefault((job.filter, job.noise), []).append(found)
    rows = [_row(name, noise, found) for (name, noise), found in groups.items()]
    gains = Gains.over(np.radians(np.linspace(-30.0, 30.0, 61)))
    invariant = max(
        abs(w.sigma[-1] / SIGMA_HEADING - 1.0) for (n, _), g in groups.items() for w in g if n == "invariant EKF"
    )
    standard = max(math.degrees(w.sigma[-1]) for (n, _), g in groups.items() for w in g if n == "standard EKF")
    return Outcome(
        f"Standing still for {SCANS:,} scans of {LANDMARKS} landmarks, the standard EKF's heading σ falls from 5° to "
        f"at most {standard:.2f}°; the right-invariant EKF's changes by {invariant:.1e} of itself. The closed form of "
        f"the gain on heading agrees with the compiled filter to {gains.worst:.0e} of the largest.",
        chosen(rows, _COLUMNS),
        {
            "filters": rows,
            "invariant_relative_change": invariant, "standard_worst_deg": standard,
            "gain_closed_form_against_numbers": gains.worst,
        },
        Table(("filter", "noise", "run", "scan", "sigma_heading_deg"), tuple(_points(groups))),
        lambda figure: draw(figure, groups, gains),
        (
            f"{LANDMARKS} landmarks all round, 3 to 15 m off; σ of a reading 0.1 m and 1° (times 0.1, 1, 10)",
            "the vehicle's position is certain, its heading normal about the estimate with σ 5°",
            f"second order and exact moments (Gauss-Hermite, 7 nodes a dimension) over {SCANS_BY_MOMENTS:,} scans, in "
            f"at most {MOST_BY_MOMENTS} of the runs: they are not compiled",
        ),
        size=(11.0, 7.6),
    )  # fmt: skip


def _points(groups: Groups) -> Iterator[tuple[object, ...]]:
    for (name, noise), found in groups.items():
        for k, w in enumerate(found):
            for scan, sigma in zip(w.scans.tolist(), w.sigma.tolist(), strict=True):
                yield name, noise, k, scan, math.degrees(sigma)


_COLUMNS = {
    "filter": "filter", "noise": "noise ×", "runs": "runs", "median_deg": "last σ (°)", "least_deg": "least",
    "most_deg": "most", "nees": "NEES",
}  # fmt: skip


def _row(name: str, noise: float, found: list[Watched]) -> dict[str, Any]:
    ends = np.degrees([w.sigma[-1] for w in found])
    return {
        "filter": name, "noise": noise, "runs": len(found), "scans": int(found[0].scans[-1]),
        "median_deg": float(np.median(ends)), "least_deg": float(ends.min()), "most_deg": float(ends.max()),
        "nees": float(np.mean([w.nees for w in found])), "nees_band": average_bounds(0.95, 1, len(found)),
    }  # fmt: skip


@dataclass(frozen=True)
class Gains:
    """The gain on heading of both innovations (n, 2), (rad/m, 1), by closed form and by the compiled filter."""

    turns: Floats
    form: Floats
    numbers: Floats
    invariant: Floats

    @staticmethod
    def over(turns: Floats) -> Gains:
        """At differences of bearing (n,) rad, the range as it was."""
        r = ANALYSED.range
        form = np.array([heading_gain(ANALYSED, r, turn) for turn in turns])
        numbers, invariant = (
            np.array([measured_gain(ANALYSED, r, turn, invariant=which) for turn in turns]) for which in (False, True)
        )
        return Gains(turns, form, numbers, invariant)

    @property
    def worst(self) -> float:
        """Largest difference between both, of the largest gain."""
        return float((np.abs(self.form - self.numbers).max(axis=0) / np.abs(self.form).max(axis=0)).max())


def draw(figure: Figure, groups: Groups, gains: Gains) -> None:
    """Heading σ against scans, by filter and by noise; the gain on heading against the difference of bearings."""
    from service.experiments import style  # only here: an extra

    style.head(figure, "phantom", "a vehicle that stands still cannot learn its heading from what it sees")
    (falls, noises), (of_range, of_bearing) = figure.subplots(2, 2)
    hues = {
        "standard EKF": style.STANDARD, "invariant EKF": style.INVARIANT, "second order": style.SECOND,
        "exact moments": style.EXACT,
    }  # fmt: skip
    for (name, noise), found in groups.items():
        if noise == 1.0:
            _curves(falls, found, hues[name], "-", name)
    for noise, line in zip(NOISES, (":", "-", "--"), strict=True):
        _curves(
            noises, groups["standard EKF", noise], style.STANDARD, line, f"standard, noise × {noise:g}", median=True
        )
    for noise in NOISES:
        label = "right-invariant, each of them" if noise == NOISES[0] else None
        _curves(noises, groups["invariant EKF", noise], style.INVARIANT, "-", label, median=True)
    limits = {"xscale": "log", "ylim": (0.0, 5.6)}
    style.dress(falls, "every run", "scans of all landmarks", "heading σ (°)", **limits)
    style.dress(noises, "at any magnitude of the noise (medians)", "scans of all landmarks", "heading σ (°)", **limits)
    for axes in (falls, noises):
        style.legend(axes, loc="upper right", bbox_to_anchor=(1.0, 0.86))
    _gains(of_range, gains, 0, "range", "m")
    _gains(of_bearing, gains, 1, "bearing", "rad")


def _gains(axes: Axes, gains: Gains, channel: int, name: str, unit: str) -> None:
    from service.experiments import style

    degrees, form, numbers = np.degrees(gains.turns), gains.form[:, channel], gains.numbers[::4, channel]
    axes.plot(degrees, form, color=style.STANDARD, lw=1.6, label="standard: closed form C S⁻¹")
    (dots,) = axes.plot(degrees[::4], numbers, "o", ms=4, color=style.STANDARD, label="standard: compiled filter")
    dots.set_markerfacecolor(style.PAPER)
    axes.plot(degrees, gains.invariant[:, channel], color=style.INVARIANT, lw=1.6, label="right-invariant: 0")
    across = "bearing now less bearing that made the landmark (°)"
    style.dress(axes, f"gain on heading of the {name}", across, f"rad per {unit} of {name}")
    style.legend(axes)


def _curves(axes: Axes, found: list[Watched], hue: str, line: str, label: str | None, *, median: bool = False) -> None:
    scans = found[0].scans
    sigmas = np.degrees([w.sigma for w in found])
    if not median:
        axes.plot(scans, sigmas.T, color=hue, alpha=0.25, lw=0.8)
    axes.plot(scans, np.median(sigmas, axis=0), line, color=hue, lw=1.8, label=label)


EXPERIMENT = Experiment("phantom", "heading σ of a vehicle that stands still and looks: the phantom update", 20, run)
