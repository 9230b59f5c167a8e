"""``nonodometry``: SLAM without odometry, by the EKF and three UKFs, in the world of Klečka's paper."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

from service.experiments.base import Experiment, Outcome, Runs
from service.experiments.nonodometry_figures import conclude, figures, series, summarise, table
from service.experiments.nonodometry_runs import BASE, FILTERS, HARD, OTHERS, STARTS, VARIANTS, Job, Run, process
from submaps.nonodometry.spiral import spiral

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ASSUMPTIONS = (
    "World: two planes at right angles, 4 × 4 points on each, 1.5 m wide; a helix of four turns, 3 m from its axis "
    "and 1.5 m high; every view sees all points, none hides another.",
    f"Camera: f = 500 pixels, noise σ = {BASE.noise:g} pixel in either coordinate.",
    "Its optical axis meets the vertical axis at a right angle (the paper says horizontal, which a spiral around "
    "that axis would call the same).",
    f"Sigma points: α = {BASE.scaling.alpha:g}, β = {BASE.scaling.beta:g}, κ = {BASE.scaling.kappa:g}, so at 0.98 σ. "
    "A tenth of the noise sets is run with other α, β and noise as well.",
    "Each noise set has its own error of the starting points, and the starting covariance says so (σ² I).",
    "Starts from n views use those views alone, and views n + 1 to 200 update: none counts twice.",
    "Gauge of those starts: the first camera's pose and its distance to the n-th are true; covariance is given those.",
    "Errors are taken as they come, in the true frame; 'shape' is eq. 26 after the best similarity.",
    "A run ends where an update fails; medians are over the runs that reached the last view.",
    "The search for a view's pose starts at the pose of the view before, or at the true first one.",
    "Time is processor time of one core, the measurement's generation and the start left out.",
)


def run(runs: Runs) -> Outcome:
    """All noise sets from all starts, and a tenth of them in other settings."""
    seeds = runs.generators(runs.count)
    jobs = [Job(k, seed, start, FILTERS, BASE) for k, seed in enumerate(seeds) for start in STARTS]
    few = runs.count // 10
    jobs += [
        Job(k, seed, start, FILTERS if setting.scaling == BASE.scaling else tuple(VARIANTS), setting)
        for k, seed in enumerate(seeds[:few]) for start in HARD for setting in OTHERS
    ]  # fmt: skip
    found = [one for group in runs.each(process, jobs, "noise sets × starts") for one in group]
    rows = summarise(found)
    return Outcome(
        summary=conclude(rows),
        table=table(rows),
        figures=figures(rows),
        series=series(found),
        draw=partial(_draw, found),
        assumptions=ASSUMPTIONS,
        size=(13.0, 5.4),
    )


def _draw(found: Sequence[Run], figure: Figure) -> None:
    from service.experiments.nonodometry_picture import draw  # an optional extra

    measures = {
        start: {
            name: [
                (one.euclidean, one.mahalanobis) for one in found
                if one.start == start and one.filter == name and one.setting == BASE
                and one.euclidean is not None and one.mahalanobis is not None
            ]
            for name in FILTERS
        }
        for start in STARTS
    }  # fmt: skip
    draw(figure, spiral(), measures)


EXPERIMENT = Experiment(
    name="nonodometry",
    about="monocular SLAM without odometry: the EKF and three UKFs on a spiral of 200 views",
    runs=100,
    run=run,
)
