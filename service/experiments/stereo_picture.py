"""The picture of ``stereo``: from above and from the side, beside Vicon."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from service.experiments.style import ATLAS, FAINT, INK, INVARIANT, SECOND, dress, head

if TYPE_CHECKING:
    from service.experiments.stereo import Told

Floats = NDArray[np.float64]


def draw(figure: Figure, with_odometry: Told, without: Told, vicon: Floats, track: Floats) -> None:
    """Landmarks and positions in Vicon's frame, seen along z and along y."""
    head(figure, "stereo", "Starry Night, aligned to Vicon by its landmarks")
    for k, (a, b, title) in enumerate(((0, 1, "from above"), (0, 2, "from the side"))):
        axes = figure.add_subplot(1, 2, k + 1)
        axes.plot(track[:, a], track[:, b], color=FAINT, lw=2.4, alpha=0.5, label="Vicon, trajectory")
        axes.plot(*without.positions[:, [a, b]].T, ls="", marker=".", ms=1.5, color=SECOND, label="without odometry")
        axes.plot(*with_odometry.positions[:, [a, b]].T, color=ATLAS, lw=0.8, label="with odometry")
        axes.plot(vicon[:, a], vicon[:, b], ls="", marker="o", ms=8, mfc="none", mec=INK, label="Vicon, landmarks")
        axes.plot(*with_odometry.landmarks[:, [a, b]].T, ls="", marker="+", ms=8, color=INVARIANT, label="landmarks")
        dress(axes, title, "x (m)", "yz"[k] + " (m)", aspect="equal")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5, frameon=False, fontsize=9, labelcolor=INK)
