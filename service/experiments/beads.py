"""``beads``: the linear world of BeadSLAM, in which a Kalman filter is exact."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from service.experiments.base import Experiment, Outcome, Runs, Table
from service.experiments.rows import chosen
from submaps.consistency import average_bounds, nees
from submaps.reference.linear import Beads, closed_form, filtered, in_order
from submaps.reference.retraction import RightInvariant, Standard
from submaps.reference.space import LINE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

WORLD = Beads(np.arange(0.0, 50.0, 5.0), (0.0, 45.0), 2.5, 8.0, start_sigma=0.5, move_sigma=0.1, reading_sigma=0.2)
CERTAIN = replace(WORLD, move_sigma=0.0)  # moves known for certain
STEPS, LONG = 400, 8_000
SETTLED = 20  # steps after which every bead has been seen


@dataclass(frozen=True)
class Told:
    """One run: NEES per degree of freedom of vehicle and beads after each step (k,), and the last difference.

    ``apart`` is that of the filters' last estimates from the closed form's, means and covariances.
    """

    nees: Floats
    apart: float


def drive(seed: np.random.SeedSequence) -> Told:
    """Run once through the world with both filters, and solve it in closed form."""
    record, truth = WORLD.drive(STEPS, np.random.default_rng(seed))
    beads = len(WORLD.beads)
    values = []
    for (estimate, slots), position in zip(filtered(record, Standard(LINE)), truth, strict=True):
        rows = in_order(LINE, slots)
        error = estimate.x[rows] - np.concatenate([[position], WORLD.beads[sorted(slots)]])
        values.append(nees(error, estimate.P[np.ix_(rows, rows)]) / len(rows))
    mean, covariance = closed_form(record, beads)
    *_, (other, _) = filtered(record, RightInvariant(LINE))
    apart = max(
        max(np.abs(e.x[rows] - mean).max(), np.abs(e.P[np.ix_(rows, rows)] - covariance).max())
        for e in (estimate, other)
    )
    return Told(np.array(values), float(apart))


@dataclass(frozen=True)
class Curves:
    """What the covariances do over the steps (k,), from the first at which every bead is known.

    ``relative`` (k, pairs) variances of m_i - m_j, ``absolute`` (k, m) of m_i, m²; ``least`` (k,) the
    lowest correlation coefficient between two beads. No reading is needed for them.
    """

    steps: NDArray[np.int64]
    relative: Floats
    absolute: Floats
    least: Floats
    limit: float


def curves(world: Beads) -> Curves:
    """Covariances over a long drive."""
    record, _ = world.drive(LONG, np.random.default_rng(0))
    noted = set(np.unique(np.geomspace(1, LONG, 160).astype(np.int64)).tolist())
    steps, relative, absolute, least = [], [], [], []
    upper = np.triu_indices(len(world.beads), 1)
    monotone, before = True, np.full(len(upper[0]), np.inf)
    for k, (estimate, slots) in enumerate(filtered(record, Standard(LINE))):
        if len(slots) < len(world.beads):
            continue
        rows = in_order(LINE, slots)[1:]
        P = estimate.P[np.ix_(rows, rows)]
        own = np.diag(P)
        between = (own[:, np.newaxis] + own - 2.0 * P)[upper]
        monotone &= bool(np.all(between <= before + 1e-12))
        before = between
        if k in noted:
            steps.append(k)
            relative.append(between)
            absolute.append(own)
            least.append(float((P / np.sqrt(np.outer(own, own))).min()))
    if not monotone:
        raise ArithmeticError("a relative covariance of the map has risen, which no Kalman filter's can")
    return Curves(np.array(steps), np.array(relative), np.array(absolute), np.array(least), world.limit)


_COLUMNS = {
    "world": "world", "limit": "limit (m²)", "bead_over_limit": "most over it",
    "difference_first": "difference, first", "difference_last": "last", "correlation_short_of_1": "1 − corr.",
}  # fmt: skip
_SERIES = ("world", "step", "bead_most", "bead_least", "difference_most", "difference_least", "least_correlation")


def run(runs: Runs) -> Outcome:
    """Many runs for the errors, one long drive for the covariances, with and without noise on the moves."""
    told = runs.each(drive, runs.generators(runs.count), "runs")
    noisy, certain = runs.each(curves, [WORLD, CERTAIN], "covariances")
    mean = np.mean([one.nees for one in told], axis=0)
    low, high = average_bounds(0.95, len(WORLD.beads) + 1, runs.count)
    inside = float(np.mean((mean[SETTLED:] >= low) & (mean[SETTLED:] <= high)))
    apart = max(one.apart for one in told)
    rows = [_row("certain moves", certain), _row("noisy moves", noisy)]
    return Outcome(
        f"The filter equals the closed form to {apart:.0e} m; variances of differences never rise, and end at "
        f"{noisy.relative[-1].max():.1e} m². With certain moves the beads' variance falls to "
        f"{certain.absolute[-1].max():.5f} m², the vehicle's first being {certain.limit:g}; with noisy moves to "
        f"{noisy.absolute[-1].max():.5f}, of which the closed form's limit is {noisy.limit:.5f}.",
        chosen(rows, _COLUMNS),
        {
            "closed_form_difference": apart,
            "nees": float(mean[SETTLED:].mean()),
            "nees_band": [low, high],
            "share_of_steps_inside_band": inside,
            "worlds": rows,
        },
        Table(_SERIES, (*_points("certain", certain), *_points("noisy", noisy))),
        lambda figure: draw(figure, noisy, certain, mean, (low, high)),
        (
            f"{len(WORLD.beads)} beads 5 m apart, seen within {WORLD.reach:g} m; σ of the first position "
            f"{WORLD.start_sigma:g} m, of a move {WORLD.move_sigma:g} m, of a reading {WORLD.reading_sigma:g} m",
            f"the vehicle runs to and fro: {STEPS} steps for the errors, {LONG:,} for the covariances",
        ),
        size=(11.0, 7.2),
    )


def _row(name: str, one: Curves) -> dict[str, object]:
    last, apart = one.absolute[-1], one.relative
    return {
        "world": name, "initial_variance": WORLD.start_sigma**2, "limit": one.limit,
        "bead_least": float(last.min()), "bead_most": float(last.max()),
        "bead_over_limit": float(last.max()) - one.limit,
        "difference_first": float(apart[0].max()), "difference_last": float(apart[-1].max()),
        "correlation_short_of_1": 1.0 - float(one.least[-1]),
    }  # fmt: skip


def _points(name: str, one: Curves) -> Iterator[tuple[object, ...]]:
    for k, a, r, c in zip(one.steps, one.absolute, one.relative, one.least, strict=True):
        yield name, int(k), float(a.max()), float(a.min()), float(r.max()), float(r.min()), float(c)


def draw(figure: Figure, noisy: Curves, certain: Curves, mean: Floats, bounds: tuple[float, float]) -> None:
    """Relative variances, the beads' own, their correlation, and the error against its covariance."""
    from service.experiments import style  # only here: an extra

    style.head(figure, "beads", "the linear world: the filter is exact, the map becomes rigid")
    (relative, absolute), (rigid, errors) = figure.subplots(2, 2)
    relative.loglog(noisy.steps, noisy.relative, color=style.ATLAS, lw=0.7, alpha=0.6)
    style.dress(relative, "variance of each difference of two beads: never rises", "step", "m²")
    for one, hue, name in ((certain, style.INVARIANT, "moves certain"), (noisy, style.STANDARD, "moves noisy")):
        absolute.semilogx(one.steps, one.absolute, color=hue, lw=0.7, alpha=0.6)
        absolute.plot([], [], color=hue, label=name)
        absolute.axhline(one.limit, color=hue, ls="--", lw=1.4)
        rigid.loglog(one.steps, 1.0 - one.least, color=hue, lw=1.6, label=name)
    absolute.plot(
        [], [], "--", color=style.INK, label="limit: the vehicle's first variance,\nand what moves leave open of it"
    )
    top = 1.25 * max(certain.limit, noisy.limit)
    style.dress(absolute, "variance of each bead", "step", "m²", ylim=(0.95 * certain.limit, top))
    style.dress(rigid, "1 − least correlation of two beads: a rigid map", "step", "")
    errors.plot(mean, color=style.INK, lw=1.0, label="mean NEES per degree of freedom")
    style.band(errors, *bounds, "95 % band")
    style.dress(errors, "error against covariance, all runs", "step", "", ylim=(0.7, 1.3))
    for axes in (absolute, rigid, errors):
        style.legend(axes)


EXPERIMENT = Experiment("beads", "the linear bead world: exact, monotone, rigid in the end", 100, run)
