"""``nonodometry``: SLAM without odometry, by the EKF and three UKFs, in the world of Klečka's paper."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from service.experiments.base import Experiment, Outcome, Runs, Table
from service.experiments.nonodometry_picture import draw
from submaps.filtering.unscented import Scaling
from submaps.nonodometry import sigma_poses
from submaps.nonodometry.belief import Belief, Status
from submaps.nonodometry.errors import euclidean, mahalanobis, shape
from submaps.nonodometry.initial import from_views, noisy
from submaps.nonodometry.moments import Filter, Unscented, extended
from submaps.nonodometry.poses import Poses
from submaps.nonodometry.sensor import Camera
from submaps.nonodometry.spiral import observe, spiral
from submaps.nonodometry.update import update

Floats = NDArray[np.float64]

CAMERA = Camera(noise=1.0, focal=(500.0, 500.0), centre=(320.0, 240.0))
BASE = Scaling(alpha=0.1, beta=2.0, kappa=0.0)
OTHERS = (Scaling(alpha=0.001), Scaling(alpha=1.0), Scaling(alpha=1.0, beta=0.0))
NOISY = {"σ 0.01": 0.01, "σ 0.1": 0.1}
FROM_VIEWS = {"4 views": 4, "16 views": 16, "64 views": 64}
STARTS = (*NOISY, *FROM_VIEWS)
HARD = ("σ 0.1", "4 views")  # the starts on which other scalings are tried as well
VARIANTS = {
    "UKF constant": sigma_poses.constant,
    "UKF linear": sigma_poses.linear,
    "UKF likelihood": sigma_poses.maximum_likelihood,
}
FILTERS = ("EKF", *VARIANTS)
_CLEARLY = 0.95  # of the EKF's error, at every start: what would count as superior

ASSUMPTIONS = (
    "World: two planes at right angles, 4 × 4 points on each, 1.5 m wide; a helix of four turns, 3 m from its axis "
    "and 1.5 m high; every view sees all points, none hides another.",
    "Camera: f = 500 pixels, noise σ = 1 pixel in either coordinate.",
    "Its optical axis meets the vertical axis at a right angle (the paper says horizontal, which a spiral around "
    "that axis would call the same).",
    f"Sigma points: α = {BASE.alpha:g}, β = {BASE.beta:g}, κ = {BASE.kappa:g}, so at 0.98 σ; other scalings are "
    "tried on a tenth of the noise sets.",
    "Each noise set has its own error of the starting points, and the starting covariance says so (σ² I).",
    "Starts from n views use those views alone, and views n + 1 to 200 update: none counts twice.",
    "Gauge of those starts: the first camera's pose and its distance to the n-th are true; covariance is given those.",
    "Errors are taken as they come, in the true frame; 'shape' is eq. 26 after the best similarity.",
    "A run ends where an update fails; medians are over the runs that reached the last view.",
    "The search for a view's pose starts at the pose of the view before, or at the true first one.",
    "Time is processor time of one core, the measurement's generation and the start left out.",
)


@dataclass(frozen=True)
class Job:
    """One noise set from one start, for some filters."""

    number: int
    seed: np.random.SeedSequence
    start: str
    filters: tuple[str, ...]
    scaling: Scaling


@dataclass(frozen=True)
class Run:
    """How one filter did: its errors are None where it failed, and ``status`` says how."""

    number: int
    start: str
    filter: str
    scaling: Scaling
    status: str
    updates: int
    seconds: float
    euclidean: float | None = None
    shape: float | None = None
    mahalanobis: float | None = None

    @property
    def done(self) -> bool:
        """Whether it reached the last view."""
        return self.euclidean is not None


def run(runs: Runs) -> Outcome:
    """All noise sets from all starts, and a tenth of them with other scalings."""
    seeds = runs.generators(runs.count)
    jobs = [Job(k, seed, start, FILTERS, BASE) for k, seed in enumerate(seeds) for start in STARTS]
    few = runs.count // 10
    jobs += [
        Job(k, seed, start, tuple(VARIANTS), scaling)
        for k, seed in enumerate(seeds[:few]) for start in HARD for scaling in OTHERS
    ]  # fmt: skip
    found = [one for group in runs.each(process, jobs, "noise sets × starts") for one in group]
    rows = summarise(found)
    return Outcome(
        summary=conclude(rows),
        table=_table(rows),
        figures=_figures(rows),
        series=_series(found),
        draw=partial(_draw, found),
        assumptions=ASSUMPTIONS,
        size=(13.0, 5.4),
    )


def process(job: Job) -> list[Run]:
    """Every filter of a job on the same views from the same start."""
    world = spiral()
    rng = np.random.default_rng(job.seed)
    z = observe(world, CAMERA, rng)
    first = world.poses.take(0)
    begin: tuple[Belief, int, Poses] | None
    if job.start in NOISY:
        begin = noisy(world.points, NOISY[job.start], rng), 0, first
    else:
        begin = _from_views(z[: FROM_VIEWS[job.start]], first, world.poses)
    return [_follow(job, name, begin, z, world.points) for name in job.filters]


def _from_views(z: Floats, first: Poses, truth: Poses) -> tuple[Belief, int, Poses] | None:
    baseline = float(np.linalg.norm(truth.position[len(z) - 1] - truth.position[0]))
    found = from_views(CAMERA, z, first, baseline)
    return (found.belief, len(z), found.poses.take(len(z) - 1)) if found.found else None


def _follow(job: Job, name: str, begin: tuple[Belief, int, Poses] | None, z: Floats, truth: Floats) -> Run:
    """One filter through the views that are left."""
    about = (job.number, job.start, name, job.scaling)
    if begin is None:
        return Run(*about, "no start", 0, 0.0)
    belief, k, pose = begin
    filter_: Filter = extended if name == "EKF" else Unscented(VARIANTS[name], job.scaling)
    began = time.process_time()
    for number, view in enumerate(z[k:], start=1):
        after = update(filter_, CAMERA, belief, view, pose)
        if after.status is not Status.done or after.pose is None:
            return Run(*about, after.status.name, number, time.process_time() - began)
        belief, pose = after.belief, after.pose
    seconds = time.process_time() - began
    errors = euclidean(belief.points, truth), shape(belief.points, truth), mahalanobis(belief, truth)
    return Run(*about, "done", len(z) - k, seconds, *errors)


@dataclass(frozen=True)
class Row:
    """Medians over the runs of one start, filter and scaling; None where no run reached the end."""

    start: str
    filter: str
    scaling: Scaling
    runs: int
    failed: int
    not_positive: int
    milliseconds: float | None
    euclidean: float | None
    shape: float | None
    mahalanobis: float | None

    @property
    def scaled(self) -> str:
        """α and β, for a filter that has them."""
        return "" if self.filter == "EKF" else _words(self.scaling)


def _words(scaling: Scaling) -> str:
    return f"α {scaling.alpha:g} β {scaling.beta:g}"


def summarise(found: Sequence[Run]) -> list[Row]:
    """One row for each start, scaling and filter, in that order."""
    groups: dict[tuple[str, Scaling, str], list[Run]] = {}
    for one in found:
        groups.setdefault((one.start, one.scaling, one.filter), []).append(one)
    order = {start: k for k, start in enumerate(STARTS)}
    keys = sorted(groups, key=lambda key: (order[key[0]], (BASE, *OTHERS).index(key[1]), FILTERS.index(key[2])))
    return [_row(key, groups[key]) for key in keys]


def _row(key: tuple[str, Scaling, str], runs: list[Run]) -> Row:
    done = [one for one in runs if one.done]
    not_positive = sum(one.status == Status.not_positive.name for one in runs)
    updates = sum(one.updates for one in runs)
    times = 1e3 * sum(one.seconds for one in runs) / updates if updates else None
    medians = [_median([getattr(one, name) for one in done]) for name in ("euclidean", "shape", "mahalanobis")]
    return Row(key[0], key[2], key[1], len(runs), len(runs) - len(done) - not_positive, not_positive, times, *medians)


def _median(values: list[float]) -> float | None:
    return float(np.median(values)) if values else None


def conclude(rows: Sequence[Row]) -> str:
    """In how far the paper's three conclusions are seen in these figures."""
    base = {(row.start, row.filter): row for row in rows if row.scaling == BASE}
    ratios = {name: _ratios(base, name) for name in ("UKF linear", "UKF likelihood")}
    superior = any(values and max(values) < _CLEARLY for values in ratios.values())
    beside = " and ".join(f"{_range(values)} ({name})" for name, values in ratios.items())
    far = [row.mahalanobis for row in base.values() if row.filter == "UKF constant" and row.mahalanobis]
    inconsistent = bool(far) and min(far) > 2.0
    cost = {name: float(np.mean([base[start, name].milliseconds or np.nan for start in STARTS])) for name in FILTERS}
    failures = {scaling: _failures(rows, scaling) for scaling in (BASE, *OTHERS)}
    unstable = ", ".join(
        f"{failed} and {lost} of {count} at {_words(scaling)}"
        for scaling, (failed, lost, count) in failures.items() if count
    )  # fmt: skip
    return (
        f"1. UKF not superior to the EKF: {_verdict(not superior)}. Median Euclidean error over the EKF's, "
        f"at the five starts: {beside}.\n"
        f"2. Constant pose highly inconsistent: {_verdict(inconsistent)}. Its median Mahalanobis error is "
        f"{_range(far)}, where 1 is right.\n"
        f"3. Likelihood variant costly: {cost['UKF likelihood'] / cost['EKF']:.1f} times the time of the EKF, "
        f"{cost['UKF likelihood'] / cost['UKF linear']:.1f} times that of the linear variant. Unstable: of its runs "
        f"failed, and lost positive definiteness, {unstable}."
    )


def _ratios(base: dict[tuple[str, str], Row], name: str) -> list[float]:
    pairs = [(base[start, name].euclidean, base[start, "EKF"].euclidean) for start in STARTS]
    return [mine / ekf for mine, ekf in pairs if mine is not None and ekf]


def _range(values: Sequence[float]) -> str:
    return f"{min(values):.3g} to {max(values):.3g}" if values else "unknown, for no run reached the end"


def _verdict(seen: bool) -> str:
    return "reproduced" if seen else "not reproduced"


def _failures(rows: Sequence[Row], scaling: Scaling) -> tuple[int, int, int]:
    mine = [row for row in rows if row.scaling == scaling and row.filter == "UKF likelihood"]
    return sum(row.failed for row in mine), sum(row.not_positive for row in mine), sum(row.runs for row in mine)


def _table(rows: Sequence[Row]) -> Table:
    columns = ("start", "filter", "sigma points", "runs", "Euclid (m)", "shape (m)", "Mahalanobis", "failed",
               "not p.d.", "ms")  # fmt: skip
    return Table(
        columns,
        tuple(
            (row.start, row.filter, row.scaled, row.runs, row.euclidean, row.shape, row.mahalanobis, row.failed,
             row.not_positive, row.milliseconds)
            for row in rows
        ),
    )  # fmt: skip


def _figures(rows: Sequence[Row]) -> dict[str, Any]:
    """Start -> filter -> scaling -> figures."""
    told: dict[str, Any] = {start: {} for start in STARTS}
    for row in rows:
        told[row.start].setdefault(row.filter, {})[row.scaled or "linearised"] = {
            "runs": row.runs, "euclidean_m": row.euclidean, "shape_m": row.shape, "mahalanobis": row.mahalanobis,
            "failed": row.failed, "not_positive_definite": row.not_positive, "ms_per_update": row.milliseconds,
        }  # fmt: skip
    return told


def _series(found: Sequence[Run]) -> Table:
    columns = ("noise_set", "start", "filter", "alpha", "beta", "status", "updates", "euclidean_m", "shape_m",
               "mahalanobis", "processor_s")  # fmt: skip
    return Table(
        columns,
        tuple(
            (one.number, one.start, one.filter, one.scaling.alpha, one.scaling.beta, one.status, one.updates,
             one.euclidean, one.shape, one.mahalanobis, one.seconds)
            for one in found
        ),
    )  # fmt: skip


def _draw(found: Sequence[Run], figure: Figure) -> None:
    measures = {
        start: {
            name: [
                (one.euclidean, one.mahalanobis) for one in found
                if one.start == start and one.filter == name and one.scaling == BASE
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
