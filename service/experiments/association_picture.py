"""The picture of the ``association`` experiment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter

from service.experiments.style import dress, head, legend
from service.exporters.picture import AXES, FAINT, INK, PAPER, ROBOTS, TREE

if TYPE_CHECKING:
    from service.experiments.association import Blunder
    from service.experiments.association_runs import Example

_RED = AXES[0]
_HUES = {"known": FAINT, "greedy": ROBOTS[0], "assignment": ROBOTS[1], "joint": TREE}
_NAMES = {"known": "known", "greedy": "greedy", "assignment": "assignment", "joint": "joint compatibility"}
_COURSES = {
    "right, then joint": (FAINT, "right, the rest by joint compatibility"),
    "wrong, then known": (ROBOTS[1], "wrong, the rest known"),
    "wrong, then joint": (_RED, "wrong, the rest by joint compatibility"),
}
_REACH = 7.0  # m, of the example


def draw(
    figure: Figure,
    cells: Sequence[dict[str, Any]],
    blunders: Sequence[Blunder],
    before: int,
    shown: Example | None,
) -> None:
    """Six panels: a scan that misleads, mistakes over noise and clutter, time, and what one mistake costs."""
    head(figure, "association", "which landmark a reading is of, and what one mistake costs")
    axes = figure.subplots(2, 3)
    _draw_example(axes[0, 0], shown)
    noise = [c for c in cells if c["clutter"] == 0.0]
    clutter = [c for c in cells if c["noise"] == 1.0]
    _draw_shares(axes[0, 1], noise, "noise", "Wrong matches over noise, without clutter")
    _draw_shares(axes[0, 2], clutter, "clutter", "Wrong matches over clutter, at noise 1")
    _draw_time(axes[1, 0], clutter)
    _draw_nees(axes[1, 1], blunders, before)
    _draw_maps(axes[1, 2], blunders)


def _draw_example(axes: Axes, shown: Example | None) -> None:
    """Where landmarks are expected, what is read, and to which of them each method gives it."""
    dress(axes, "One scan that misleads", "x ahead of the predicted pose (m)", "y (m)")
    axes.set(xlim=(-_REACH, _REACH), ylim=(-_REACH, _REACH), aspect="equal")
    if shown is None:
        axes.text(0.0, 0.0, "no scan misled the greedy method alone", ha="center", color=FAINT, fontsize=9)
        return
    for found, hue, width, layer in ((shown.joint, TREE, 4.5, 2), (shown.greedy, ROBOTS[0], 1.6, 3)):
        for reading, landmark in zip(shown.readings, found.tolist(), strict=True):
            if landmark >= 0:
                axes.plot(*np.stack([reading, shown.landmarks[landmark]]).T, color=hue, lw=width, zorder=layer,
                          alpha=0.5 if layer == 2 else 1.0, solid_capstyle="round")  # fmt: skip
    axes.plot(*shown.landmarks.T, ls="", marker="o", ms=6, mfc=PAPER, mec=INK, mew=1.2, zorder=4)
    axes.plot(*shown.readings.T, ls="", marker="x", ms=5, mec=_RED, mew=1.6, zorder=5)
    axes.plot(0.0, 0.0, marker=(3, 0, -90), ms=9, color=INK, zorder=5)
    legend(axes, handles=[
        Line2D([], [], ls="", marker="o", ms=6, mfc=PAPER, mec=INK, label="landmark, as predicted"),
        Line2D([], [], ls="", marker="x", ms=5, mec=_RED, mew=1.6, label="reading"),
        Line2D([], [], color=TREE, lw=4.5, alpha=0.5, label="joint: all right"),
        Line2D([], [], color=ROBOTS[0], lw=1.6, label=f"greedy: {shown.mistakes} wrong"),
    ])  # fmt: skip


def _draw_shares(axes: Axes, cells: Sequence[dict[str, Any]], over: str, title: str) -> None:
    labels = {
        "noise": "noise, in multiples of the σ named",
        "clutter": "false readings a scan",
    }
    dress(axes, title, labels[over], "readings given to a wrong landmark (%)")
    for method in ("greedy", "assignment", "joint"):
        mine = [c for c in cells if c["method"] == method]
        x, y = [c[over] for c in mine], [100.0 * c["wrong"] for c in mine]
        axes.plot(x, y, color=_HUES[method], marker="o", ms=4, lw=1.8, ls="--" if method == "assignment" else "-")
    axes.set_ylim(bottom=0.0)
    legend(axes, handles=[
        Line2D([], [], color=_HUES[m], marker="o", ms=4, ls="--" if m == "assignment" else "-", label=_NAMES[m])
        for m in ("greedy", "assignment", "joint")
    ])  # fmt: skip


def _draw_time(axes: Axes, cells: Sequence[dict[str, Any]]) -> None:
    dress(axes, "Time, distances and choice", "false readings a scan", "a step (µs)")
    for method in ("greedy", "assignment", "joint"):
        mine = [c for c in cells if c["method"] == method]
        x, y = [c["clutter"] for c in mine], [c["microseconds"] for c in mine]
        axes.plot(x, y, color=_HUES[method], marker="o", ms=4, lw=1.8, label=_NAMES[method])
    axes.set_ylim(bottom=0.0)
    legend(axes)


def _draw_nees(axes: Axes, blunders: Sequence[Blunder], before: int) -> None:
    """Median and quartiles of the pose's NEES around the mistake."""
    dress(axes, "One wrong match: the pose", "steps since", "NEES per degree of freedom")
    for name, (hue, label) in _COURSES.items():
        length = min(b.courses[name].pose_nees.size for b in blunders)
        whole = np.stack([b.courses[name].pose_nees[:length] for b in blunders])
        steps = np.arange(length) - before
        low, middle, high = np.quantile(whole, (0.25, 0.5, 0.75), axis=0)
        axes.fill_between(steps, low, high, color=hue, alpha=0.2, lw=0)
        axes.plot(steps, middle, color=hue, lw=1.8, label=label)
    axes.axhline(1.0, color=INK, lw=0.8, ls=":")
    axes.set_yscale("log")
    axes.set_ylim(top=3e4)
    legend(axes, loc="upper left")


def _draw_maps(axes: Axes, blunders: Sequence[Blunder]) -> None:
    """Each run's map at the end, by what followed."""
    dress(
        axes, "One wrong match: the map", "error of the landmarks at the end (m)", "NEES of all, per degree of freedom"
    )
    for name, (hue, label) in _COURSES.items():
        points = np.array([(b.courses[name].map_rmse, b.courses[name].map_nees) for b in blunders])
        axes.plot(*points.T, ls="", marker="o", ms=5.5, mfc=hue, mec=PAPER, mew=0.7, label=label)
    axes.set(xscale="log", yscale="log")
    axes.axhline(1.0, color=INK, lw=0.8, ls=":")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
    axes.xaxis.set_major_formatter(_plain)
    axes.xaxis.set_minor_formatter(NullFormatter())
    legend(axes, loc="upper left")


def _plain(value: float, _: object = None) -> str:
    return f"{value:g}"
