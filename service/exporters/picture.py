"""A picture of a map: trajectories, the frames of the sub-maps, landmarks with their uncertainty.

A map in space is drawn as seen from above: x and y of everything.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from service.exporters.atlas import Atlas, Track
from submaps.geometry.space import Space

Floats = NDArray[np.float64]

INK, FAINT, PAPER = "#22303c", "#8a97a3", "#fbfbf9"
TREE = "#1b7f4b"
AXES = ("#c8372d", "#2f6fb3", "#6d7f2a")  # a frame's x, y and z axes
# Neighbouring sub-maps differ in hue; none is that of a landmark.
SUBMAPS = ("#e0912f", "#7a5ea8", "#3b8fb5", "#c25b86", "#8c7a3d", "#5b6bb8")
# Where there are several robots each has one hue; more than there are hues share them.
ROBOTS = ("#e0912f", "#3b6fc4", "#b0418f", "#7a6a2c", "#11a0a8", "#6b4bb0", "#d0574a", "#4d4d4d")
_MOST_NAMED, _MOST_FRAMES = 12, 300
_WIDTH, _DPI = 10.0, 160


def draw(atlas: Atlas, path: Path) -> None:
    """Write the picture as the file's suffix says (PNG, SVG, PDF); raises ``OSError``, ``ValueError``."""
    low, high = _extent(atlas)
    span = np.maximum(high - low, 1.0)
    height = float(np.clip(_WIDTH * span[1] / span[0], 5.0, 13.0))
    entries = _legend_entries(atlas)
    room = 1.3 + 0.25 * max(-(-len(entries) // 3) - 2, 0)  # for the title and the legend
    figure = Figure(figsize=(_WIDTH, height + room), dpi=_DPI, facecolor=PAPER, layout="constrained")
    axes = figure.add_subplot()
    reach = float(span.max())
    for k, track in enumerate(atlas.tracks):
        _draw_track(axes, track, None if len(atlas.tracks) == 1 else ROBOTS[k % len(ROBOTS)])
    frames = atlas.frames[:: _frames_apart(atlas)]
    crowd = np.clip(100.0 / max(len(frames), 1), 0.6, 1.0)  # many frames: shorter strokes
    _draw_frames(axes, frames, atlas.space, 0.016 * reach * float(crowd))
    _draw_landmarks(axes, atlas)
    _dress(axes, atlas, low, high)
    _add_legend(axes, entries)
    figure.savefig(path)


def ellipses(covariances: Floats, sigmas: float) -> tuple[Floats, Floats, Floats]:
    """Full widths, full heights (m) and turns (degrees) of the ellipses of (n, 2, 2) covariances."""
    values, vectors = np.linalg.eigh(covariances)
    axes = 2.0 * sigmas * np.sqrt(np.maximum(values, 0.0))
    return axes[:, 1], axes[:, 0], np.degrees(np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1]))


def _from_above(atlas: Atlas) -> Floats:
    """Covariances (n, 2, 2) of x and y."""
    return atlas.covariances[:, :2, :2]


def _frames_apart(atlas: Atlas) -> int:
    """Of so many frames one is drawn: more than some hundreds would hide the trajectories."""
    return max(-(-len(atlas.frames) // _MOST_FRAMES), 1)


def _extent(atlas: Atlas) -> tuple[Floats, Floats]:
    ways = [track.trajectory.poses[:, :2] for track in atlas.tracks]
    points = np.vstack([atlas.landmarks[:, :2], atlas.frames[:, :2], *ways])
    if not points.size:
        return np.array([-1.0, -1.0]), np.array([1.0, 1.0])
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.04 * float(np.max(high - low)) + 1.0
    return low - margin, high + margin


def _draw_track(axes: Axes, track: Track, hue: str | None) -> None:
    """A trajectory in a robot's hue, or in one for each sub-map."""
    points = track.trajectory.poses[:, :2]
    if len(points) < 2:
        return
    pieces = np.stack([points[:-1], points[1:]], axis=1)
    hues = [hue or SUBMAPS[k % len(SUBMAPS)] for k in track.submap[1:].tolist()]
    axes.add_collection(LineCollection(list(pieces), colors=hues, linewidths=1.3 if hue is None else 0.8, zorder=2))
    axes.plot(*points[0], marker="o", ms=7, mfc=PAPER, mec=hue or INK, mew=1.6, zorder=6)
    axes.plot(*points[-1], marker="s", ms=7, mfc=hue or INK, mec=PAPER, mew=1.2, zorder=6)


def _draw_frames(axes: Axes, frames: Floats, space: Space, length: float) -> None:
    if not len(frames):
        return
    R = np.array([space.rotation(frame) for frame in frames])
    for axis, hue in zip(range(space.dim), AXES, strict=False):
        tips = frames[:, :2] + length * R[:, :2, axis]
        strokes = np.stack([frames[:, :2], tips], axis=1)
        axes.add_collection(LineCollection(list(strokes), colors=hue, linewidths=0.9, zorder=3))


def _draw_landmarks(axes: Axes, atlas: Atlas) -> None:
    if not len(atlas.landmarks):
        return
    points = atlas.landmarks[:, :2]
    widths, heights, turns = ellipses(_from_above(atlas), 2.0)
    shapes = EllipseCollection(
        widths, heights, turns, units="xy", offsets=points, offset_transform=axes.transData, zorder=1
    )
    shapes.set(facecolor=TREE + "40", edgecolor=TREE, linewidth=0.9)
    axes.add_collection(shapes)
    axes.plot(*points.T, linestyle="", marker="o", ms=1.8, mew=0, color=TREE, zorder=5)


def _dress(axes: Axes, atlas: Atlas, low: Floats, high: Floats) -> None:
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", facecolor=PAPER)
    axes.set_xlabel("x (m)", color=INK)
    axes.set_ylabel("y (m)", color=INK)
    axes.grid(color=INK, alpha=0.07, linewidth=0.7)
    axes.tick_params(colors=FAINT, labelcolor=INK, length=3)
    for side in axes.spines.values():
        side.set(color=FAINT, alpha=0.5)
    counts = atlas.counts
    names = {"steps": "step", "observations": "observation", "landmarks": "landmark", "submaps": "sub-map"}
    told = [f"{counts[key]:,} {one}{'s' * (counts[key] != 1)}" for key, one in names.items()]
    if atlas.unconnected:
        told.append(f"not connected yet: {', '.join(atlas.unconnected)}")
    title = atlas.name if atlas.space.dim == 2 else f"{atlas.name}, seen from above (x, y)"
    axes.set_title(title, loc="left", color=INK, fontsize=15, fontweight="bold", pad=26)
    axes.text(0.0, 1.012, "   ".join(told), transform=axes.transAxes, color=FAINT, fontsize=9.5, va="bottom")


def _robots(atlas: Atlas) -> list[Line2D]:
    """What the hues of the trajectories mean."""
    if len(atlas.tracks) < 2:
        return [Line2D([], [], color=SUBMAPS[0], lw=1.6, label="trajectory, one hue a sub-map")]
    named = [
        Line2D([], [], color=ROBOTS[k % len(ROBOTS)], lw=1.6, label=track.robot)
        for k, track in enumerate(atlas.tracks[:_MOST_NAMED])
    ]
    more = len(atlas.tracks) - _MOST_NAMED
    return named + ([Line2D([], [], lw=0, label=f"and {more} more robots")] if more > 0 else [])


def _legend_entries(atlas: Atlas) -> list[Line2D]:
    size = ""
    if len(atlas.landmarks):
        size = f" (median half-axis {np.median(ellipses(_from_above(atlas), 2.0)[0]) / 2:.2g} m)"
    apart = _frames_apart(atlas)
    some = "" if apart == 1 else f" (one in {apart})"
    return [
        *_robots(atlas),
        *(
            Line2D([], [], color=hue, lw=1.6, label=f"sub-map frame{some}: {name}")
            for name, hue in zip("xyz"[: atlas.space.dim], AXES, strict=False)
        ),
        Line2D(
            [], [], ls="", marker="o", ms=9, mfc=TREE + "38", mec=TREE, mew=0.9, label=f"landmark, 2σ ellipse{size}"
        ),
        Line2D([], [], ls="", marker="o", ms=6, mfc=PAPER, mec=INK, mew=1.5, label="first pose"),
        Line2D([], [], ls="", marker="s", ms=6, mfc=INK, mec=PAPER, label="last pose"),
    ]


def _add_legend(axes: Axes, entries: list[Line2D]) -> None:
    axes.legend(
        handles=entries,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.06),
        ncols=3,
        frameon=False,
        fontsize=9,
        labelcolor=INK,
    )
