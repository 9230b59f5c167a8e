"""``flatland``: the lecture's bicycle in a field of landmarks, many times: is the estimate as good as it says?"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from service.experiments.base import Experiment, Outcome, Runs, Table
from service.experiments.rows import chosen
from submaps.atlas.joining import join
from submaps.config import FilterName, MapConfig
from submaps.consistency import average_bounds, nees
from submaps.mapper import Mapper
from submaps.measurements import Batch
from submaps.reference.flatland import FAR, NEAR, Field, Flatland

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

CHUNK = 20  # steps between two looks at the estimate
FIELDS = {"near": NEAR, "far": FAR}
WAYS: dict[str, tuple[FilterName, bool]] = {  # filter, and whether sub-maps may close
    "standard EKF": ("standard", False),
    "invariant EKF": ("invariant", False),
    "sub-maps": ("invariant", True),
}
_OUT_OF_REACH = 1e9


def configure(world: Flatland, filter: FilterName, submaps: bool) -> MapConfig:
    """The world's own models and noise; one map is a sub-map whose bounds are out of reach."""
    config = MapConfig(world.motion, world.observation, filter)
    if submaps:
        return config
    return replace(config, max_landmarks=1000, max_heading_sigma=_OUT_OF_REACH, max_position_sigma=_OUT_OF_REACH)


@dataclass(frozen=True)
class Drawn:
    """One run's map: the way (k, 2) and true way (k, 2), landmarks (m, 2) with covariances and their truth."""

    way: Floats
    true_way: Floats
    landmarks: Floats
    covariances: Floats
    true_landmarks: Floats


@dataclass(frozen=True)
class Told:
    """What one way said of one run, at each look and at the end.

    After so many ``steps`` (k,): errors (k, 3) and σ (k, 3) of (x m, y m, psi rad), and their NEES (k,) per
    degree of freedom. At the end: the landmarks' mean NEES per degree of freedom, their error (m), how
    many sub-maps there were, and the map.
    """

    steps: tuple[int, ...]
    errors: Floats
    sigmas: Floats
    nees: Floats
    landmarks: float
    landmark_rmse: float
    submaps: int
    map: Drawn


def drive(job: tuple[str, np.random.SeedSequence]) -> list[Told]:
    """One world, one drive, every way of estimating."""
    name, seed = job
    rng = np.random.default_rng(seed)
    world = FIELDS[name].planted(rng)
    batch, poses = world.drive(rng)
    return [estimate(world, batch, poses, *how) for how in WAYS.values()]


def estimate(world: Flatland, batch: Batch, poses: Floats, filter: FilterName, submaps: bool) -> Told:
    """Take the drive in, looking at the pose in ``map`` as it goes, each time with everything joined."""
    mapper = Mapper(configure(world, filter, submaps))
    errors, sigmas, values, way, ends = [], [], [], [], []
    for piece, last in chunks(batch, CHUNK):
        mapper.apply("robot", piece)
        if submaps:
            mapper.install(join(mapper.problem()))
        pose = mapper.view().pose("robot", "map" if submaps else "submap/0")
        error = np.array([pose.x, pose.y, pose.theta]) - poses[last]
        error[2] = math.remainder(error[2], 2.0 * math.pi)
        errors.append(error)
        sigmas.append(np.sqrt(np.diag(pose.covariance)))
        values.append(nees(error, pose.covariance) / 3.0)
        way.append((pose.x, pose.y))
        ends.append(last)
    view = mapper.view()
    names = view.landmark_ids()
    found = [view.landmark(name, "map" if submaps else "submap/0") for name in names]
    points = np.array([(one.x, one.y) for one in found])
    covariances = np.array([one.covariance for one in found])
    truth = world.landmarks[[int(name) for name in names]]
    off = points - truth
    whole = float(np.mean([nees(e, P) for e, P in zip(off, covariances, strict=True)])) / 2.0
    rmse = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
    return Told(
        tuple(ends), np.array(errors), np.array(sigmas), np.array(values), whole, rmse, view.submap_count,
        Drawn(np.array(way), poses[ends, :2], points, covariances, truth),
    )  # fmt: skip


def chunks(batch: Batch, steps: int) -> Iterator[tuple[Batch, int]]:
    """The batch in pieces of so many steps, each with the number of its last step."""
    for begin in range(0, batch.steps, steps):
        end = min(begin + steps, batch.steps)
        c = (batch.control_step >= begin) & (batch.control_step < end)
        o = np.flatnonzero((batch.observation_step >= begin) & (batch.observation_step < end))
        yield replace(
            batch, t=batch.t[begin:end], control_step=batch.control_step[c] - begin,
            control=np.ascontiguousarray(batch.control[:, c]), observation_step=batch.observation_step[o] - begin,
            landmark=tuple(batch.landmark[i] for i in o), z=np.ascontiguousarray(batch.z[:, o]),
        ), end - 1  # fmt: skip


def run(runs: Runs) -> Outcome:
    """Both fields, many drives, every way."""
    seeds = runs.generators(runs.count)
    jobs = [(name, seed) for name in FIELDS for seed in seeds]
    found = runs.each(drive, jobs, "drives")
    told = {name: found[k * runs.count : (k + 1) * runs.count] for k, name in enumerate(FIELDS)}
    band = average_bounds(0.95, 3, runs.count)
    rows = [_row(field, way, [one[w] for one in told[field]], band) for field in FIELDS for w, way in enumerate(WAYS)]
    worst = {(row["field"], row["way"]): row["nees"] for row in rows}
    standard, single, joined = ([worst[field, way] for field in FIELDS] for way in WAYS)
    return Outcome(
        f"Mean NEES of the pose per degree of freedom, the whole drive (band at one moment {band[0]:.2f} to "
        f"{band[1]:.2f}): standard EKF {standard[0]:.2f} near and {standard[1]:.1f} far, right-invariant EKF "
        f"{single[0]:.2f} and {single[1]:.2f}, its sub-maps joined {joined[0]:.2f} and {joined[1]:.2f}.",
        chosen(rows, _COLUMNS),
        {"nees_band": list(band), "ways": rows},
        Table(_SERIES, tuple(_points(told))),
        lambda figure: draw(figure, told, band),
        (
            *(f"{name}: {_described(one)}" for name, one in FIELDS.items()),
            "speed 2 m/s, wheelbase 1.5 m, dt 0.2 s; landmarks are known apart and drawn anew for each run",
            "the EKFs keep one map; the sub-maps are the right-invariant filter's, joined at each look, every "
            f"{CHUNK} steps; the map's origin is the vehicle's first pose, known for certain",
        ),
        size=(12.0, 8.6),
    )  # fmt: skip


_COLUMNS = {
    "field": "field", "way": "way", "nees": "NEES", "nees_inside": "in band", "within_2_sigma": "in 2σ",
    "within_6_sigma": "in 6σ", "rmse_m": "RMSE (m)", "landmark_nees": "map NEES",
}  # fmt: skip
_SERIES = (
    "field", "way", "run", "step", "nees", "error_x", "error_y", "error_psi", "sigma_x", "sigma_y", "sigma_psi",
)  # fmt: skip


def _points(told: dict[str, list[list[Told]]]) -> Iterator[tuple[object, ...]]:
    for field, runs in told.items():
        for k, ways in enumerate(runs):
            for way, one in zip(WAYS, ways, strict=True):
                for i, step in enumerate(one.steps):
                    yield field, way, k, step, float(one.nees[i]), *one.errors[i].tolist(), *one.sigmas[i].tolist()


def _row(field: str, way: str, told: list[Told], band: tuple[float, float]) -> dict[str, Any]:
    mean = np.mean([one.nees for one in told], axis=0)[1:]  # at the first look the pose is certain
    shares = np.abs(np.array([one.errors[1:] / one.sigmas[1:] for one in told]))
    square = np.array([np.sum(one.errors[:, :2] ** 2, axis=1) for one in told])
    return {
        "field": field, "way": way, "runs": len(told), "submaps": float(np.mean([one.submaps for one in told])),
        "nees": float(mean.mean()), "nees_inside": float(np.mean((mean >= band[0]) & (mean <= band[1]))),
        "nees_end": float(mean[-1]),
        "within_2_sigma": float(np.mean(shares <= 2.0)), "within_6_sigma": float(np.mean(shares <= 6.0)),
        "rmse_m": float(np.sqrt(square.mean())), "rmse_end_m": float(np.sqrt(square[:, -1].mean())),
        "landmark_nees": float(np.mean([one.landmarks for one in told])),
        "landmark_rmse_m": float(np.sqrt(np.mean([one.landmark_rmse**2 for one in told]))),
    }  # fmt: skip


def _described(one: Field) -> str:
    control, reading = one.control_sigma, one.reading_sigma
    return (
        f"{one.laps:g} laps of {one.radius:g} m radius, {one.landmarks} landmarks within {one.aside:g} m of it, seen "
        f"within {one.reach:g} m at every second step; σ of speed {control[0]:g} m/s, of steer "
        f"{math.degrees(control[1]):g}°, of range {reading[0]:g} m, of bearing {math.degrees(reading[1]):g}°"
    )


def draw(figure: Figure, told: dict[str, list[list[Told]]], band: tuple[float, float]) -> None:
    """Mean NEES over time; one run's heading against 2σ and 6σ; the same run's maps."""
    from service.experiments import style  # only here: an extra

    style.head(figure, "flatland", "the lecture's bicycle: does the estimate say how wrong it is?")
    hues = dict(zip(WAYS, (style.STANDARD, style.INVARIANT, style.ATLAS), strict=True))
    places = figure.subplot_mosaic([["near", "near", "far", "far"], ["h0", "h1", "m0", "m1"]])
    for field in FIELDS:
        axes = places[field]
        for w, (way, hue) in enumerate(hues.items()):
            mean = np.mean([one[w].nees for one in told[field]], axis=0)
            plot = axes.semilogy if field == "far" else axes.plot
            plot(told[field][0][w].steps[1:], mean[1:], color=hue, lw=1.6, label=way)
        style.band(axes, *band, "95 % band")
        axes.yaxis.set_major_formatter("{x:g}")
        style.dress(axes, f"{field}: mean NEES of the pose, {len(told[field])} runs", "step", "per degree of freedom")
    style.legend(places["far"], loc="upper left")
    ends = [one[0].landmark_rmse for one in told["far"]]
    shown = told["far"][int(np.argsort(ends)[3 * len(ends) // 4])]  # a bad one, not the worst, of the standard EKF
    for place, w, way in (("h0", 0, "standard"), ("h1", 2, "sub-maps")):
        axes, one = places[place], shown[w]
        steps, hue = one.steps, list(hues.values())[w]
        error, sigma = np.degrees(one.errors[:, 2]), np.degrees(one.sigmas[:, 2])
        axes.fill_between(steps, -6 * sigma, 6 * sigma, color=hue, alpha=0.08, lw=0, label="6σ")
        axes.fill_between(steps, -2 * sigma, 2 * sigma, color=hue, alpha=0.2, lw=0, label="2σ")
        axes.plot(steps, error, color=style.INK, lw=1.1, label="error")
        style.dress(axes, f"far, one run: heading, {way}", "step", "heading error (°)", ylim=(-40.0, 40.0))
        style.legend(axes, loc="lower left")
        _map(places["m" + place[1]], one.map, hue, way)


def _map(axes: Axes, drawn: Drawn, hue: str, way: str) -> None:
    from matplotlib.collections import EllipseCollection

    from service.experiments import style
    from service.exporters.picture import ellipses

    widths, heights, turns = ellipses(drawn.covariances, 2.0)
    shapes = EllipseCollection(
        widths, heights, turns, units="xy", offsets=drawn.landmarks, offset_transform=axes.transData
    )
    shapes.set(facecolor=hue + "30", edgecolor=hue, linewidth=0.7)
    axes.add_collection(shapes)
    axes.plot(*drawn.true_way.T, color=style.FAINT, lw=1.0)
    axes.plot(*drawn.way.T, color=hue, lw=1.2)
    axes.plot(*drawn.true_landmarks.T, "+", color=style.INK, ms=4, mew=0.9, label="truth")
    style.legend(axes, loc="upper left")
    axes.set_aspect("equal", adjustable="datalim")
    style.dress(axes, f"the same run: 2σ, {way}", "x (m)", "y (m)")


EXPERIMENT = Experiment("flatland", "Monte-Carlo runs of the lecture's bicycle: is the estimate consistent?", 50, run)
