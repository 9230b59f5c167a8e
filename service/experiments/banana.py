"""``banana``: what a range and an uncertain bearing look like, and what a covariance can say of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from service.experiments.base import Experiment, Outcome, Runs, Table
from service.experiments.rows import chosen
from submaps.consistency import chi_square_bound
from submaps.reference.moments import Exact, ShownRangeBearing, first_order

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

RANGE, SIGMA_RANGE = 10.0, 0.2  # m
DEGREES = (0.5, 1.0, 2.0, 5.0, 10.0, 45.0)
BOUND = chi_square_bound(0.95, 2)
_GRID = 1200  # points of a side, for the quadrature
_MOST_DRAWN = 2_000


@dataclass(frozen=True)
class Cloud:
    """Points (n, 2) m of one bearing noise (rad), and what each description of them says.

    ``inside`` are the shares of points in the regions that should hold 95 %: the ellipse of the
    linearisation, that of the exact mean and covariance, and the region in exponential coordinates.
    Correlation is that of the exact covariance; mutual information, of x and y, is in nats.
    """

    sigma: float
    points: Floats
    linear: tuple[Floats, Floats]
    exact: tuple[Floats, Floats]
    inside: tuple[float, float, float]
    correlation: float
    information: float

    @property
    def waste(self) -> float:
        """How many times the area of the exponential coordinates' region the exact moments' ellipse takes."""
        return math.sqrt(np.linalg.det(self.exact[1])) / (RANGE * self.sigma * SIGMA_RANGE)


def cloud(task: tuple[float, int, np.random.SeedSequence]) -> Cloud:
    """So many points with a bearing noise of so many degrees."""
    degrees, count, seed = task
    rng, sigma = np.random.default_rng(seed), math.radians(degrees)
    r, beta = RANGE + SIGMA_RANGE * rng.normal(size=count), sigma * rng.normal(size=count)
    points = np.stack([r * np.cos(beta), r * np.sin(beta)], axis=1)
    mean, P = np.array([0.0, RANGE, 0.0]), np.diag([1e-24, SIGMA_RANGE**2, sigma**2])
    linear, exact = (rule(ShownRangeBearing(), mean, P)[:2] for rule in (first_order, Exact(41)))
    turn, along = exponential(points)
    shares = (
        _inside(points, *linear), _inside(points, *exact),
        float(np.mean((turn / sigma) ** 2 + (along / SIGMA_RANGE) ** 2 < BOUND)),
    )  # fmt: skip
    spread = np.sqrt(np.diag(exact[1]))
    information = mutual_information(density(sigma), *window(sigma))
    return Cloud(
        sigma, points, (linear[0], linear[1]), (exact[0], exact[1]), shares,
        float(exact[1][0, 1] / (spread[0] * spread[1])), information,
    )  # fmt: skip


def exponential(points: Floats) -> tuple[Floats, Floats]:
    """Exponential coordinates of points (n, 2): the turn (rad) and the error along the reading (m), each (n,).

    l = R(xi_theta) l^ + V(xi_theta) xi_l with l^ = (RANGE, 0), xi_l = (xi, 0): what the right-invariant
    error keeps normal. Solved by Newton's method, from the polar coordinates.
    """
    turn, along = np.arctan2(points[:, 1], points[:, 0]), np.hypot(points[:, 0], points[:, 1]) - RANGE
    for _ in range(8):
        off = curved(turn, along) - points
        h = 1e-6
        by_turn = (curved(turn + h, along) - curved(turn - h, along)) / (2.0 * h)
        by_along = curved(turn, along + 1.0) - curved(turn, along)
        step = np.linalg.solve(np.stack([by_turn, by_along], axis=2), off[:, :, np.newaxis])[:, :, 0]
        turn, along = turn - step[:, 0], along - step[:, 1]
    return turn, along


def curved(turn: Floats, along: Floats) -> Floats:
    """Points (n, 2) of exponential coordinates: V(t) (1, 0) = sin(t/2) / (t/2) (cos(t/2), sin(t/2))."""
    shorter = along * np.sinc(turn / (2.0 * math.pi))
    return np.stack(
        [RANGE * np.cos(turn) + shorter * np.cos(turn / 2), RANGE * np.sin(turn) + shorter * np.sin(turn / 2)], axis=1
    )


def _inside(points: Floats, mean: Floats, P: Floats) -> float:
    apart = points - mean
    return float(np.mean(np.sum(apart * np.linalg.solve(P, apart.T).T, axis=1) < BOUND))


# -- what correlation does not see ---------------------------------------------------------------


def density(sigma: float) -> Callable[[Floats, Floats], Floats]:
    """p(x, y) of (r cos beta, r sin beta): p(r) p(beta) / r, the bearing's density wrapped round."""

    def p(x: Floats, y: Floats) -> Floats:
        r, beta = np.hypot(x, y), np.arctan2(y, x)
        around = sum(np.exp(-0.5 * ((beta + 2.0 * math.pi * k) / sigma) ** 2) for k in range(-3, 4))
        radial = np.exp(-0.5 * ((r - RANGE) / SIGMA_RANGE) ** 2)
        return np.asarray(radial * around / (2.0 * math.pi * sigma * SIGMA_RANGE * np.maximum(r, 1e-9)))

    return p


def window(sigma: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Where the density is more than nothing: seven σ each way."""
    reach = 7.0 * sigma
    outer = RANGE + 7.0 * SIGMA_RANGE
    low = (RANGE - 7.0 * SIGMA_RANGE) * math.cos(reach) if reach < math.pi / 2 else -outer
    side = outer * math.sin(min(reach, math.pi / 2)) * 1.1
    return (low, outer), (-side, side)


def mutual_information(
    p: Callable[[Floats, Floats], Floats], xs: tuple[float, float], ys: tuple[float, float], grid: int = _GRID
) -> float:
    """I(x; y) in nats, the integral of p log(p / (p_x p_y)), by the trapezoidal rule.

    For a smooth density that has died away at the edges the rule converges faster than any power, so
    that there is no bias as histograms of samples have it.
    """
    x, y = np.linspace(*xs, grid), np.linspace(*ys, grid)
    dx, dy = float(x[1] - x[0]), float(y[1] - y[0])
    joint = p(x[np.newaxis, :], y[:, np.newaxis])
    apart = np.outer(joint.sum(axis=1) * dx, joint.sum(axis=0) * dy)
    there = joint > 0.0
    return float(np.sum(joint[there] * np.log(joint[there] / apart[there])) * dx * dy)


# -- the experiment ------------------------------------------------------------------------------


def run(runs: Runs) -> Outcome:
    """A cloud for each bearing noise of the lecture."""
    tasks = [(d, runs.count, seed) for d, seed in zip(DEGREES, runs.generators(len(DEGREES)), strict=True)]
    clouds = runs.each(cloud, tasks, "clouds")
    rows = [_row(degrees, one) for degrees, one in zip(DEGREES, clouds, strict=True)]
    last, before = clouds[-1], clouds[-2]
    return Outcome(
        f"At a bearing noise of 45° the linearised 95 % ellipse holds {last.inside[0]:.0%} of the points, that of the "
        f"exact moments {last.inside[1]:.0%} on {last.waste:.0f} times the area of the region in exponential "
        f"coordinates, which holds {last.inside[2]:.0%}; x and y are uncorrelated and share {last.information:.2f} "
        f"nats ({before.information:.2f} at 10°).",
        chosen(rows, _COLUMNS),
        {"noises": rows},
        Table(
            ("sigma_deg", "x", "y"),
            tuple((d, *point) for d, c in zip(DEGREES, clouds, strict=True) for point in c.points.tolist()),
        ),
        lambda figure: draw(figure, clouds),
        (
            f"range {RANGE:g} m with σ {SIGMA_RANGE:g} m; mean bearing 0, straight ahead: the exact correlation is 0",
            "runs are points; range and bearing noise are independent and normal",
            "mutual information by quadrature of the density, not from samples",
        ),
        size=(11.5, 8.4),
    )  # fmt: skip


_COLUMNS = {
    "sigma_deg": "σ (°)", "inside_linear": "linear", "inside_exact": "exact", "inside_exponential": "expon.",
    "area_exact_to_exponential": "area ×", "sampled_correlation": "corr.", "mutual_information_nats": "nats",
    "gaussian_correlation": "as corr.",
}  # fmt: skip


def _row(degrees: float, c: Cloud) -> dict[str, float]:
    linear, exact, exponential = c.inside
    return {
        "sigma_deg": degrees, "inside_linear": linear, "inside_exact": exact, "inside_exponential": exponential,
        "area_exact_to_exponential": c.waste, "correlation": c.correlation,
        "sampled_correlation": float(np.asarray(np.corrcoef(c.points.T))[0, 1]),
        "mutual_information_nats": c.information, "gaussian_correlation": _as_correlation(c.information),
    }  # fmt: skip


def _as_correlation(information: float) -> float:
    """|rho| with which two normal variables share so much: I = -log(1 - rho²) / 2."""
    return math.sqrt(1.0 - math.exp(-2.0 * information))


def draw(figure: Figure, clouds: list[Cloud]) -> None:
    """The clouds with what describes them, the last one to scale; correlation beside mutual information."""
    from service.experiments import style  # only here: an extra

    style.head(
        figure, "banana", "a landmark 10 m away, its bearing uncertain, and regions that should hold 95 % of the points"
    )
    places = figure.subplot_mosaic([["0", "1", "2"], ["3", "4", "5"], ["m", "m", "m"]], height_ratios=[1.0, 1.0, 0.75])
    for k, one in enumerate(clouds):
        axes = places[str(k)]
        axes.plot(*one.points[:_MOST_DRAWN].T, ".", ms=1.4, color=style.FAINT, alpha=0.55, label="points")
        _ellipse(axes, *one.linear, style.STANDARD, "-", "linearised")
        _ellipse(axes, *one.exact, style.EXACT, "--", "exact mean and covariance")
        around = np.linspace(0.0, 2.0 * math.pi, 400)
        root = math.sqrt(BOUND)
        edge = curved(root * one.sigma * np.cos(around), root * SIGMA_RANGE * np.sin(around))
        axes.plot(*edge.T, color=style.INVARIANT, lw=1.5, label="exponential coordinates")
        style.dress(axes, f"bearing σ {DEGREES[k]:g}°", "x (m)", "y (m)")
        if DEGREES[k] > 20.0:
            axes.set_aspect("equal", adjustable="datalim")
    shapes = places["0"].get_legend_handles_labels()
    figure.legend(*shapes, loc="outside lower center", ncols=4, frameon=False, fontsize=9, markerscale=5)
    _shared(places["m"], clouds)


def _shared(axes: Axes, clouds: list[Cloud]) -> None:
    """Correlation beside mutual information."""
    from service.experiments import style

    shared, linear = [_as_correlation(c.information) for c in clouds], [abs(c.correlation) for c in clouds]
    label = "|correlation| of a Gaussian with the same mutual information"
    axes.semilogx(DEGREES, shared, "o-", color=style.INK, label=label)
    axes.semilogx(DEGREES, linear, "s-", color=style.STANDARD, label="|correlation| of x and y")
    for c, at in zip(clouds, zip(DEGREES, shared, strict=True), strict=True):
        told = f"{c.information:.2g} nats"
        axes.annotate(told, at, (0, 7), textcoords="offset points", ha="center", fontsize=8, color=style.INK)
    title = "x and y: uncorrelated, not independent"
    style.dress(axes, title, "σ of the bearing (°)", "", ylim=(-0.05, 1.2), xticks=DEGREES)
    axes.set_xticks(DEGREES, [f"{d:g}" for d in DEGREES])
    axes.minorticks_off()
    style.legend(axes, loc="center left")


def _ellipse(axes: Axes, mean: Floats, P: Floats, hue: str, line: str, label: str) -> None:
    around = np.linspace(0.0, 2.0 * math.pi, 200)
    edge = mean + math.sqrt(BOUND) * np.stack([np.cos(around), np.sin(around)], axis=1) @ np.linalg.cholesky(P).T
    axes.plot(*edge.T, line, color=hue, lw=1.5, label=label)


EXPERIMENT = Experiment("banana", "range and bearing against the ellipse: what a covariance cannot say", 4_000, run)
