"""``submaps evaluate``: how far a trajectory, or a whole map, lies from the truth."""

from __future__ import annotations

from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.client import Client
from service.commands.console import (
    DEFAULT_URL,
    INPUT,
    Json,
    MapName,
    Url,
    fail,
    print_json,
    print_rows,
    print_table,
    the_map,
)
from service.datasets import read_source
from service.datasets.tum import read_tum
from service.wire.poses import pose_answer
from submaps.config import SpaceName

if TYPE_CHECKING:
    from service.evaluating import MapError
    from submaps.evaluation import Statistics


class Apart(StrEnum):
    """What ``--delta`` counts."""

    frames = "frames"
    meters = "meters"


class Of(StrEnum):
    """What ``--space`` chooses."""

    se2 = "se2"
    se3 = "se3"


def evaluate(
    estimate: Annotated[Path | None, typer.Argument(help="An estimated trajectory, a TUM file.")] = None,
    truth: Annotated[Path | None, typer.Argument(help="The true trajectory, a TUM file.")] = None,
    source: Annotated[
        str | None, typer.Option("--truth", help="A data set with truth, such as an MRCLAM folder, for a whole map.")
    ] = None,
    url: Url = DEFAULT_URL,
    map_: MapName = None,
    align: Annotated[bool, typer.Option(help="Lay the trajectory over the truth before its absolute error.")] = True,
    delta: Annotated[float, typer.Option(min=1e-6, help="How far apart the poses of a relative error lie.")] = 1.0,
    unit: Annotated[Apart, typer.Option(help="What delta counts; metres are those of the estimate.")] = Apart.meters,
    max_difference: Annotated[
        float, typer.Option(min=0.0, help="Seconds by which poses that belong together may differ.")
    ] = 0.01,
    space: Annotated[
        Of, typer.Option(help="What of TUM files counts: se2, x, y and the yaw; se3, the whole of the poses.")
    ] = Of.se2,
    json: Json = False,
) -> None:
    """Compare with the truth: two trajectories (ESTIMATE TRUTH), or a map of a service (--truth SOURCE)."""
    from submaps.evaluation import NothingInCommon

    if (estimate is None or truth is None) == (source is None) or (source is not None and estimate is not None):
        fail("give either two TUM files, ESTIMATE and TRUTH, or --truth SOURCE for a map", INPUT)
    try:
        if source is not None:
            _a_map(url, map_, source, delta, unit, json)
        elif estimate is not None and truth is not None:
            _trajectories(estimate, truth, align, (delta, unit), max_difference, space.value, json)
    except NothingInCommon as error:
        fail(str(error), INPUT)


def _trajectories(
    estimate: Path, truth: Path, align: bool, apart: tuple[float, Apart], most: float, space: SpaceName, json: bool
) -> None:
    from submaps.evaluation import absolute_error, associate, relative_error

    own, true = associate(read_tum(estimate, space), read_tum(truth, space), most)
    absolute = absolute_error(own, true, aligned=align)
    relative, turn = relative_error(own, true, apart[0], apart[1].value)
    if json:
        print_json({
            "aligned": align,
            "absolute_m": asdict(absolute),
            "delta": apart[0],
            "unit": apart[1],
            "relative_m": asdict(relative),
            "relative_rad": asdict(turn),
        })  # fmt: skip
        return
    print_table(
        ["", "RMSE", "mean", "median", "max", "number"],
        [
            _cells("absolute, aligned" if align else "absolute, as it comes", absolute, "m"),
            _cells(f"relative, {apart[0]:g} {apart[1]}", relative, "m"),
            _cells(f"the same, {_turn(own.space.dim)}", turn, "rad"),
        ],
    )


def _turn(dim: int) -> str:
    return "heading" if dim == 2 else "rotation"


def _cells(label: str, found: Statistics, unit: str) -> list[str]:
    values = (found.rmse, found.mean, found.median, found.max)
    return [label, *(f"{value:.4f} {unit}" for value in values), f"{found.count:,}"]


def _a_map(url: str, map_: str | None, source: str, delta: float, unit: Apart, json: bool) -> None:
    from service.evaluating import map_error

    run = read_source(source)
    if run.truth is None:
        fail(f"{source}: holds no truth to compare with", INPUT)
    with Client(url) as client:
        name = the_map(client, map_)
        found = map_error(client, name, run.truth, delta, unit.value)
    if json:
        print_json({"map": name, "delta": delta, "unit": unit, **_told(found)})
    else:
        _show(name, found, f"{delta:g} {unit}")


def _told(found: MapError) -> dict[str, Any]:
    return {
        "landmarks_m": asdict(found.landmarks.statistics),
        "landmark_nees": found.landmarks.nees,
        "pose_nees": found.pose_nees,
        "alignment": pose_answer(found.landmarks.alignment.pose),
        "robots": {robot: asdict(error) for robot, error in found.robots.items()},
        "unconnected": found.unconnected,
    }


def _show(name: str, found: MapError, apart: str) -> None:
    landmarks = found.landmarks
    space = landmarks.alignment.space
    rows = [
        (f"RMSE of {landmarks.statistics.count} landmarks, aligned", f"{landmarks.statistics.rmse:.4f} m"),
        ("the largest of them", f"{landmarks.statistics.max:.4f} m"),
        (f"their NEES by {space.dim}n - {space.pose} (alignment takes {space.pose})", f"{landmarks.nees:.2f}"),
    ]
    if found.pose_nees is not None:
        label = f"NEES of {found.poses} last poses by {space.pose}n, aligned as landmarks"
        rows.append((label, f"{found.pose_nees:.2f}"))
    if found.unconnected:
        rows.append(("not connected yet", ", ".join(found.unconnected)))
    print_rows(f"{name} against the truth", rows)
    if found.robots:
        print_table(
            ["robot", "poses", "ATE", "ATE, aligned as landmarks", f"RPE, {apart}", _turn(space.dim)],
            [
                [robot, f"{e.absolute.count:,}", *(f"{v.rmse:.4f} m" for v in (e.absolute, e.common, e.relative)),
                 f"{e.turn.rmse:.4f} rad"]
                for robot, e in found.robots.items()
            ],
        )  # fmt: skip
