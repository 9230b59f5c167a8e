"""What an experiment leaves behind: its picture, its CSV, and its figures as one object."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from service.experiments.base import Outcome, Runs, Table

_DPI = 130


def cell(value: object) -> str:
    """A value as a table shows it: four digits of a number, a dash for what is not there."""
    if value is None:
        return "–"
    if isinstance(value, (bool, np.bool_)):
        return "yes" if value else "no"
    if isinstance(value, (int, np.integer)):
        return f"{int(value):,}"
    if isinstance(value, (float, np.floating)):
        return f"{float(value):.4g}" if np.isfinite(value) else "–" if np.isnan(value) else str(float(value))
    return str(value)


def told(name: str, runs: Runs, outcome: Outcome, files: dict[str, Path]) -> dict[str, Any]:
    """An outcome as one object; what a number cannot say (NaN, infinity) is null in JSON."""
    return {
        "experiment": name,
        "runs": runs.count,
        "seed": runs.seed,
        "summary": outcome.summary,
        "assumptions": list(outcome.assumptions),
        "figures": outcome.figures,
        "files": {kind: str(path) for kind, path in files.items()},
    }


def write_csv(table: Table, path: Path) -> None:
    """Every row, numbers in full."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(table.columns)
        writer.writerows(table.rows)


def write_picture(outcome: Outcome, path: Path) -> None:
    """Draw in the colours of this project's other pictures."""
    import matplotlib
    from matplotlib.figure import Figure

    from service.exporters.picture import FAINT, INK, PAPER

    style: Any = {
        "axes.facecolor": PAPER, "axes.edgecolor": FAINT, "axes.labelcolor": INK, "axes.titlecolor": INK,
        "axes.titlesize": 11, "axes.titlelocation": "left", "axes.grid": True, "axes.axisbelow": True,
        "grid.color": INK + "1c", "grid.linewidth": 0.7, "text.color": INK,
        "xtick.color": FAINT, "ytick.color": FAINT, "xtick.labelcolor": INK, "ytick.labelcolor": INK,
        "legend.frameon": False, "legend.fontsize": 9,
    }  # fmt: skip
    with matplotlib.rc_context(style):
        figure = Figure(figsize=outcome.size, dpi=_DPI, facecolor=PAPER, layout="constrained")
        outcome.draw(figure)
        figure.savefig(path)
