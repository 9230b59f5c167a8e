"""``scaling``: what a prediction and an update cost, in one map and in sub-maps: the lecture's orders as slopes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from service.experiments.base import Experiment, Outcome, Runs, Table
from service.experiments.costs import (
    MAP_SIZES,
    PARTS,
    SEEN_AT,
    SLOPE_FROM,
    SLOPE_TO,
    Series,
    filters,
    maps,
    seen_together,
)
from service.experiments.rows import chosen

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLUMNS = {"what": "what", "order": "order", "slope": "slope", "smallest": "at the least", "largest": "at the most"}
Measured = dict[str, list[Series]]  # by what is drawn together


def run(runs: Runs) -> Outcome:
    """One thing after the other, each in one worker: two at once would share a cache."""
    measured: Measured = {"one filter": list(filters(runs)), "together": list(seen_together(runs))}
    both = list(maps(runs))
    measured["map"], measured["bytes"] = [cost for cost, _ in both], [size for _, size in both]
    whole = {n: 8.0 * (3 + 2 * n) ** 2 for n in MAP_SIZES}
    measured["bytes"].insert(0, Series("one map, P whole", "N²", 2.0, "landmarks", cost=whole))
    each = [(one, "bytes" if group == "bytes" else "µs") for group, found in measured.items() for one in found]
    rows = [_row(one, unit) for one, unit in each]
    return Outcome(
        _summary(measured),
        chosen(rows, _COLUMNS),
        {"series": rows},
        Table(
            ("what", "unit", "against", "n", "value"),
            tuple((one.name, unit, one.by, n, value) for one, unit in each for n, value in one.cost.items()),
        ),
        lambda figure: draw(figure, measured),
        (
            "processor time, the best of as many rounds as runs; of the map, the median batch of the way back",
            f"slopes of a filter from {SLOPE_FROM} to {SLOPE_TO} landmarks: below, a call's fixed cost shows; above, "
            "its covariance leaves the cache",
            "t sub-maps share the landmarks out evenly, and an update touches one of them",
        ),
        size=(13.0, 8.8),
    )


def _summary(measured: Measured) -> str:
    named = {one.name: one for one in measured["one filter"]}
    update, naive = "update, compiled", "update (I − WH) P"
    plain = " and ".join(f"{_gain(named, update, t):.0f} times (t = {t}, t² = {t**2})" for t in PARTS)
    slow = " and ".join(f"{_gain(named, naive, t):.0f} times (t³ = {t**3:,})" for t in PARTS)
    flat = [one.cost[MAP_SIZES[-1]] / one.cost[MAP_SIZES[0]] for one in measured["map"]]
    return (
        f"Slopes of the cost against N: prediction {named['prediction, standard'].slope:.2f} (lecture: 1), update "
        f"{named[update].slope:.2f} (2), (I − WH)P {named[naive].slope:.2f} (3). With {SLOPE_TO} landmarks in t "
        f"sub-maps an update is cheaper {plain}, (I − WH)P {slow}. "
        f"In the map itself an observation among {MAP_SIZES[-1]:,} landmarks costs {min(flat):.2f} to "
        f"{max(flat):.2f} times one among {MAP_SIZES[0]}."
    )


def _gain(named: dict[str, Series], name: str, parts: int) -> float:
    """How many times cheaper an update in one of so many sub-maps is, at the largest N of the slopes."""
    return named[name].cost[SLOPE_TO] / named[f"{name}, t = {parts}"].cost[SLOPE_TO]


def _row(one: Series, unit: str) -> dict[str, object]:
    least, most = (f"{_amount(one.cost[n], unit)} at {n:,}" for n in (min(one.cost), max(one.cost)))
    return {
        "what": f"{one.name}, {unit}" if unit == "bytes" else one.name, "unit": unit, "against": one.by,
        "order": f"O({one.order})", "slope": one.slope, "expected": one.expected, "smallest": least, "largest": most,
        "values": {str(n): value for n, value in one.cost.items()},
    }  # fmt: skip


def _amount(value: float, unit: str) -> str:
    """Three digits, with as large a unit as leaves something before the point."""
    for larger in ("ms", "s") if unit == "µs" else ("kB", "MB", "GB"):
        if value < 999.5:
            break
        value, unit = value / 1e3, larger
    return f"{value:.3g} {unit}"


def draw(figure: Figure, measured: Measured) -> None:
    """Cost against N of one filter, of sub-maps, of the map itself; against M; and bytes."""
    from service.experiments import style  # only here: an extra

    style.head(figure, "scaling", "the lecture's orders, measured; slopes in the legends")
    places = figure.subplot_mosaic([["whole", "parts", "bytes"], ["map", "many", "bytes"]])
    single = measured["one filter"]
    for name, group, title, across, up in (
        ("whole", [one for one in single if one.parts == 1], "one filter", "landmarks N", "µs"),
        ("parts", [one for one in single if one.name[0] == "u"], "an update among t sub-maps", "landmarks N", "µs"),
        ("map", measured["map"], "the map itself", "landmarks N", "µs an observation"),
        (
            "many",
            measured["together"],
            f"several observations a step, {SEEN_AT} landmarks",
            "observations M",
            "µs a step",
        ),
        ("bytes", measured["bytes"], "bytes of the estimates", "landmarks N", "bytes"),
    ):
        _lines(places[name], group, style.HUES)
        style.dress(places[name], title, across, up)
        style.legend(places[name], **({"loc": "lower right"} if name == "parts" else {}))
    places["parts"].set_ylim(bottom=1e-3)
    places["map"].set_ylim(0.0, 2.0 * max(max(one.cost.values()) for one in measured["map"]))


def _lines(axes: Axes, group: list[Series], hues: tuple[str, ...]) -> None:
    for one, hue in zip(group, hues, strict=False):
        n, cost = list(one.cost), list(one.cost.values())
        plot = axes.semilogx if one.expected == 0.0 else axes.loglog
        plot(n, cost, "o-", ms=3.5, color=hue, lw=1.5, label=f"{one.name}: {one.slope:+.2f}")


EXPERIMENT = Experiment("scaling", "cost and memory against landmarks, sub-maps and observations, as slopes", 5, run)
