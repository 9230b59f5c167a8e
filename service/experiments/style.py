"""How the experiments' pictures look; imported only where one is drawn, for it needs the extra ``plot``."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from service.exporters.picture import AXES, FAINT, INK, PAPER, SUBMAPS, TREE

# One hue for each filter, in every picture.
STANDARD, INVARIANT, ATLAS = AXES[0], TREE, AXES[1]
SECOND, EXACT, THIRD = SUBMAPS[0], SUBMAPS[1], SUBMAPS[3]
HUES = (STANDARD, INVARIANT, ATLAS, SECOND, EXACT, THIRD, SUBMAPS[4])

__all__ = ["ATLAS", "EXACT", "FAINT", "HUES", "INK", "INVARIANT", "PAPER", "SECOND", "STANDARD", "THIRD"]


def head(figure: Figure, title: str, subtitle: str) -> None:
    """The paper, and what the picture says in one line."""
    figure.set_facecolor(PAPER)
    figure.suptitle(f"$\\bf{{{title.replace(' ', '~')}}}$   {subtitle}", x=0.01, ha="left", color=INK, fontsize=12)


def dress(axes: Axes, title: str, xlabel: str, ylabel: str, **settings: Any) -> None:
    """Title, labels, grid and colours of one diagram; ``settings`` as ``Axes.set`` takes them."""
    axes.set(xlabel=xlabel, ylabel=ylabel, facecolor=PAPER, **settings)
    axes.set_title(title, loc="left", color=INK, fontsize=10.5)
    axes.grid(color=INK, alpha=0.08, linewidth=0.7)
    axes.tick_params(which="both", colors=FAINT, labelcolor=INK, length=3, labelsize=8.5)
    axes.xaxis.label.set(color=INK, fontsize=9.5)
    axes.yaxis.label.set(color=INK, fontsize=9.5)
    for side in axes.spines.values():
        side.set(color=FAINT, alpha=0.5)


def legend(axes: Axes, **settings: Any) -> None:
    """A legend without a frame."""
    axes.legend(frameon=False, fontsize=8.5, labelcolor=INK, **settings)


def band(axes: Axes, low: float, high: float, label: str) -> None:
    """A horizontal band in which a figure should lie."""
    axes.axhspan(low, high, color=INVARIANT, alpha=0.12, lw=0, label=label)
