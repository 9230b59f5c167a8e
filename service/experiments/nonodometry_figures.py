"""What ``nonodometry`` says of its runs: medians, counts of failures, the paper's conclusions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from service.experiments.base import Table
from service.experiments.nonodometry_runs import BASE, FILTERS, OTHERS, STARTS, Run, Setting
from submaps.nonodometry.belief import Status

_CLEARLY = 0.95  # of the EKF's error, at every start: what would count as superior


@dataclass(frozen=True)
class Row:
    """Medians over the runs of one start, filter and setting; None where no run reached the end."""

    start: str
    filter: str
    setting: Setting
    runs: int
    failed: int
    not_positive: int
    milliseconds: float | None
    euclidean: float | None
    shape: float | None
    mahalanobis: float | None

    @property
    def scaling(self) -> str:
        """α and β, for a filter that has them."""
        return "" if self.filter == "EKF" else _words(self.setting)


def _words(setting: Setting) -> str:
    return f"α {setting.scaling.alpha:g} β {setting.scaling.beta:g}"


def summarise(found: Sequence[Run]) -> list[Row]:
    """One row for each start, setting and filter, in that order."""
    groups: dict[tuple[str, Setting, str], list[Run]] = {}
    for one in found:
        groups.setdefault((one.start, one.setting, one.filter), []).append(one)
    order = {start: k for k, start in enumerate(STARTS)}
    keys = sorted(groups, key=lambda key: (order[key[0]], (BASE, *OTHERS).index(key[1]), FILTERS.index(key[2])))
    return [_row(key, groups[key]) for key in keys]


def _row(key: tuple[str, Setting, str], runs: list[Run]) -> Row:
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
    base = {(row.start, row.filter): row for row in rows if row.setting == BASE}
    ratios = {name: _ratios(base, name) for name in ("UKF linear", "UKF likelihood")}
    superior = any(values and max(values) < _CLEARLY for values in ratios.values())
    beside = " and ".join(f"{_range(values)} ({name})" for name, values in ratios.items())
    far = [row.mahalanobis for row in base.values() if row.filter == "UKF constant" and row.mahalanobis]
    inconsistent = bool(far) and min(far) > 2.0
    cost = {name: float(np.mean([base[start, name].milliseconds or np.nan for start in STARTS])) for name in FILTERS}
    failures = {setting: _failures(rows, setting) for setting in (BASE, *OTHERS)}
    unstable = ", ".join(
        f"{failed} and {lost} of {count} at {_words(setting)} and {setting.noise:g} px"
        for setting, (failed, lost, count) in failures.items() if count
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


def _failures(rows: Sequence[Row], setting: Setting) -> tuple[int, int, int]:
    mine = [row for row in rows if row.setting == setting and row.filter == "UKF likelihood"]
    return sum(row.failed for row in mine), sum(row.not_positive for row in mine), sum(row.runs for row in mine)


def table(rows: Sequence[Row]) -> Table:
    """What is printed."""
    columns = ("start", "filter", "sigma points", "noise (px)", "runs", "Euclid (m)", "shape (m)", "Mahalanobis",
               "failed", "not p.d.", "ms")  # fmt: skip
    return Table(
        columns,
        tuple(
            (row.start, row.filter, row.scaling, row.setting.noise, row.runs, row.euclidean, row.shape,
             row.mahalanobis, row.failed, row.not_positive, row.milliseconds)
            for row in rows
        ),
    )  # fmt: skip


def figures(rows: Sequence[Row]) -> dict[str, Any]:
    """By start and filter, one entry for each setting."""
    told: dict[str, Any] = {start: {name: [] for name in FILTERS} for start in STARTS}
    for row in rows:
        told[row.start][row.filter].append({
            "alpha": row.setting.scaling.alpha, "beta": row.setting.scaling.beta, "noise_px": row.setting.noise,
            "runs": row.runs, "euclidean_m": row.euclidean, "shape_m": row.shape, "mahalanobis": row.mahalanobis,
            "failed": row.failed, "not_positive_definite": row.not_positive, "ms_per_update": row.milliseconds,
        })  # fmt: skip
    return told


def series(found: Sequence[Run]) -> Table:
    """Every run."""
    columns = ("noise_set", "start", "filter", "alpha", "beta", "noise_px", "status", "updates", "euclidean_m",
               "shape_m", "mahalanobis", "processor_s")  # fmt: skip
    return Table(
        columns,
        tuple(
            (one.number, one.start, one.filter, one.setting.scaling.alpha, one.setting.scaling.beta,
             one.setting.noise, one.status, one.updates, one.euclidean, one.shape, one.mahalanobis, one.seconds)
            for one in found
        ),
    )  # fmt: skip
