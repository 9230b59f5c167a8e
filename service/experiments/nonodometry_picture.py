"""The picture of ``nonodometry``: the world (the paper's Figure 1) and both errors (its Figure 2)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from service.exporters.picture import FAINT, INK, PAPER
from submaps.nonodometry.spiral import Spiral

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HUES = {"EKF": INK, "UKF constant": "#c8372d", "UKF linear": "#2f6fb3", "UKF likelihood": "#e0912f"}
PLANES = ("#1b7f4b", "#7a5ea8")

Measures = dict[str, dict[str, list[tuple[float, float]]]]  # start -> filter -> (Euclidean, Mahalanobis) of each run


def draw(figure: Figure, world: Spiral, measures: Measures) -> None:
    """World on the left, medians with quartiles on the right, on logarithmic scales."""
    grid = figure.add_gridspec(1, 3, width_ratios=(1.15, 1.0, 1.0))
    _world(figure.add_subplot(grid[0], projection="3d"), world)
    left, right = figure.add_subplot(grid[1]), figure.add_subplot(grid[2])
    _errors(left, measures, 0, "Sum of Euclidean errors (m), eq. 26")
    _errors(right, measures, 1, "Mahalanobis error / dimension, eq. 27")
    right.axhline(1.0, color=FAINT, lw=1.2, ls="--", zorder=1)
    right.annotate(
        "1: consistent", (1.0, 1.0), xycoords=("axes fraction", "data"), xytext=(-4, 3), textcoords="offset points",
        ha="right", va="bottom", fontsize=8.5, color=FAINT,
    )  # fmt: skip
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower right", ncols=len(labels))


def _world(axes: Any, world: Spiral) -> None:
    path, half = world.poses.position, len(world.points) // 2
    axes.plot(*path.T, color=FAINT, lw=1.0)
    axes.scatter(*path[::10].T, s=7, color=INK, depthshade=False)
    for k in range(0, len(path), 10):  # optical axes
        axes.plot(*np.stack([path[k], path[k] + 0.55 * world.poses.rotation[k, :, 2]]).T, color="#c8372d", lw=0.9)
    for points, hue in ((world.points[:half], PLANES[0]), (world.points[half:], PLANES[1])):
        low, high = 1.15 * points.min(axis=0), 1.15 * points.max(axis=0)
        corners = [np.array([[low[k], high[k]], [low[k], high[k]]]) for k in (0, 1)]
        axes.plot_surface(*corners, np.array([[low[2]] * 2, [high[2]] * 2]), color=hue, alpha=0.16, lw=0)
        axes.scatter(*points.T, s=14, color=hue, depthshade=False)
    axes.plot([0, 0], [0, 0], [-1.1, 1.1], color=INK, lw=0.9, ls=":")
    axes.set_title(f"{len(world.points)} points on two planes, {len(path)} views")
    axes.set(xlabel="x (m)", ylabel="y (m)", xticks=(-2, 0, 2), yticks=(-2, 0, 2), zticks=(-1, 0, 1))
    axes.set_box_aspect((1, 1, 0.5), zoom=1.05)
    axes.view_init(elev=27, azim=-52)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color(PAPER)


def _errors(axes: Axes, measures: Measures, which: int, title: str) -> None:
    for number, (name, hue) in enumerate(HUES.items()):
        values = [[run[which] for run in by_filter.get(name, [])] for by_filter in measures.values()]
        where = [k for k, one in enumerate(values) if one]
        low, middle, high = np.array([np.percentile(values[k], (25, 50, 75)) for k in where]).reshape(-1, 3).T
        if where:
            beside = np.array(where) + 0.17 * (number - 1.5)
            reach = (middle - low, high - middle)
            axes.errorbar(beside, middle, reach, fmt="o", ms=6, lw=1.6, capsize=2.5, color=hue, label=name)
    axes.set_yscale("log")
    named = [f"{start} m" if start.startswith("σ") else start for start in measures]
    axes.set_xticks(range(len(measures)), named, rotation=20)
    axes.set_xlim(-0.5, len(measures) - 0.5)
    axes.grid(axis="x", visible=False)
    axes.set_title(title)
