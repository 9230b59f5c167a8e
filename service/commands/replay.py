"""``submaps replay``: send a recorded run through the service, and tell how it went."""

from __future__ import annotations

from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.client import Client
from service.commands.console import Json, bar, print_json, print_rows, print_table
from service.commands.plot import check_picture, draw
from service.datasets import SOURCES, Dataset, read_source
from service.standalone import own_service

if TYPE_CHECKING:
    from service.evaluating import MapError
    from service.replaying import Replayed
    from submaps.alignment import Alignment


@dataclass(frozen=True)
class Found:
    """How a replay went: beside the batch optimum, and beside the truth, where there is one."""

    run: Dataset
    done: Replayed
    to_batch: Alignment | None
    to_truth: MapError | None
    batch_to_truth: Alignment | None


def replay(
    source: Annotated[str, typer.Argument(help=f"{SOURCES[0].upper()}{SOURCES[1:]} (needs the extra demo).")],
    url: Annotated[
        str | None, typer.Option(help="Address of a running service; without it, one is started for the run.")
    ] = None,
    map_: Annotated[
        str | None, typer.Option("--map", help="Name of the map to create. [default: that of the data]")
    ] = None,
    json: Json = False,
    batch: Annotated[
        bool, typer.Option(help="Compute the batch optimum too, and compare the landmarks with it.")
    ] = True,
    plot: Annotated[Path | None, typer.Option(help="Draw the map into this file (needs the extra plot).")] = None,
    without_odometry: Annotated[
        bool, typer.Option("--without-odometry", help="Leave the odometry out: a map without motion, in space only.")
    ] = False,
) -> None:
    """Replay a recorded run through the service over HTTP, solve the map, and tell how it went."""
    from service.replaying import map_name  # brings in the compiled kernel

    run = read_source(source, odometry=not without_odometry)
    if plot is not None:
        check_picture(plot)
    name = map_ or map_name(run)
    with ExitStack() as stack:
        address = url or stack.enter_context(own_service())
        client = stack.enter_context(Client(address))
        found = _replayed(client, run, name, batch, json)
        if json:
            print_json(_told(found))
        else:
            _show(found)
        if plot is not None:
            draw(client, name, plot, quiet=json)


def _replayed(client: Client, run: Dataset, name: str, batch: bool, quiet: bool) -> Found:
    from service.evaluating import map_error
    from service.replaying import batch_points, compare, has_batch, replay
    from submaps.evaluation import NothingInCommon

    to_batch = to_truth = batch_to_truth = None
    with bar(quiet) as progress:
        through = progress.add_task("Replaying through HTTP", total=run.steps)
        done = replay(client, run, name, lambda n, _: progress.update(through, completed=n))
        if batch and has_batch(run):
            solving = progress.add_task("Solving the batch optimum", total=None)
            best = batch_points(run, lambda n, total: progress.update(solving, completed=n, total=total))
            to_batch = compare(done.points, best)
            if run.truth is not None:
                batch_to_truth = compare(best, run.truth.landmarks)
    if run.truth is not None:
        with suppress(NothingInCommon):
            to_truth = map_error(client, name, run.truth)
    return Found(run, done, to_batch, to_truth, batch_to_truth)


def _told(found: Found) -> dict[str, Any]:
    done = found.done
    told: dict[str, Any] = {
        "map": done.map,
        "steps": done.steps,
        "observations": done.observations,
        "landmarks": done.landmarks,
        "submaps": done.submaps,
        "microseconds_per_observation": round(done.microseconds_per_observation, 3),
        "ingest_seconds": round(done.ingest_seconds, 6),
        "solve_seconds": round(done.solve_seconds, 6),
        "notes": dict(found.run.notes),
        "robots": {name: _told_of(found, name) for name in done.robots},
    }
    if found.to_batch is not None:
        told["landmark_rmse"] = found.to_batch.rmse
        told["landmark_rmse_unaligned"] = found.to_batch.rmse_before
    if found.to_truth is not None:
        told["landmark_rmse_to_truth"] = found.to_truth.landmarks.statistics.rmse
    if found.batch_to_truth is not None:
        told["batch_landmark_rmse_to_truth"] = found.batch_to_truth.rmse
    return told


def _told_of(found: Found, robot: str) -> dict[str, Any]:
    part = found.done.robots[robot]
    told: dict[str, Any] = {
        "steps": part.steps,
        "observations": part.observations,
        "rejected": dict(part.rejected),
        "connected": part.connected,
    }
    if found.to_truth is not None and robot in found.to_truth.robots:
        told["absolute_trajectory_rmse"] = found.to_truth.robots[robot].absolute.rmse
    return told


def _show(found: Found) -> None:
    done = found.done
    rows = [
        ("steps", f"{done.steps:,}"),
        ("observations", f"{done.observations:,}"),
        ("landmarks", f"{done.landmarks:,}"),
        ("sub-maps", f"{done.submaps:,}"),
        ("an observation, HTTP and journal included", f"{done.microseconds_per_observation:.1f} µs"),
        ("last solve of the atlas", f"{1e3 * done.solve_seconds:.0f} ms"),
    ]
    rows += [(note, f"{count:,}") for note, count in found.run.notes.items()]
    if found.to_batch is not None:
        rows.append(("landmark RMSE to the batch optimum, aligned", f"{found.to_batch.rmse:.4f} m"))
        rows.append(("the same, as it comes", f"{found.to_batch.rmse_before:.4f} m"))
    if found.to_truth is not None:
        rows.append(("landmark RMSE to the truth, aligned", f"{found.to_truth.landmarks.statistics.rmse:.4f} m"))
    if found.batch_to_truth is not None:
        rows.append(("the batch optimum's", f"{found.batch_to_truth.rmse:.4f} m"))
    print_rows(f"{done.map}, replayed over HTTP", rows)
    if len(done.robots) > 1:
        heads = ["robot", "steps", "observations", "rejected", "connected", "ATE to the truth"]
        print_table(heads, [_row(found, robot) for robot in done.robots])


def _row(found: Found, robot: str) -> list[str]:
    part = found.done.robots[robot]
    rejected = ", ".join(f"{count:,} {reason}" for reason, count in part.rejected.items()) or "0"
    known = found.to_truth is not None and robot in found.to_truth.robots
    error = f"{found.to_truth.robots[robot].absolute.rmse:.4f} m" if known and found.to_truth else "-"
    return [robot, f"{part.steps:,}", f"{part.observations:,}", rejected, "yes" if part.connected else "no", error]
