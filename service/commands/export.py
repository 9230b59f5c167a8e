"""``submaps export``: write a map, or a trajectory, in a format that other tools read."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import orjson
import typer

from service.client import Client, path_of
from service.commands.console import DEFAULT_URL, INPUT, MapName, Url, check_folder, errors, fail, the_map


class Format(StrEnum):
    """What to write."""

    g2o = "g2o"
    tum = "tum"
    json = "json"


def export(
    format_: Annotated[
        Format,
        typer.Option("--format", help="g2o: sub-maps and landmarks as a graph; tum: trajectories; json: everything."),
    ],
    url: Url = DEFAULT_URL,
    map_: MapName = None,
    robot: Annotated[str | None, typer.Option(help="Whose trajectory. [default: each robot's, a file each]")] = None,
    out: Annotated[Path | None, typer.Option(help="File to write. [default: standard output]")] = None,
) -> None:
    """Write a map as g2o or JSON, or trajectories in the format of TUM (all in the frame `map`)."""
    if robot is not None and format_ is not Format.tum:
        fail(f"--robot chooses a trajectory; {format_} holds the whole map", INPUT)
    if out is not None:
        check_folder(out)
    with Client(url) as client:
        name = the_map(client, map_)
        if format_ is Format.tum:
            _trajectories(client, name, robot, out)
        else:
            _write({Format.g2o: _g2o, Format.json: _json}[format_](client, name), out)


def _g2o(client: Client, map_: str) -> str:
    from service.exporters.g2o import as_g2o, read_graph

    return "".join(as_g2o(read_graph(client, map_)))


def _json(client: Client, map_: str) -> str:
    path = path_of(map_)
    everything: dict[str, Any] = {
        **client.request("GET", path),
        "robots": client.robots(map_),
        "landmarks": client.landmarks(map_),
        "submaps": list(client.pages(f"{path}/submaps", "submaps")),
        "graph": client.request("GET", f"{path}/graph"),
    }
    return orjson.dumps(everything, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE).decode()


def _trajectories(client: Client, map_: str, robot: str | None, out: Path | None) -> None:
    robots = [] if robot is None else [robot]
    if robot is None:
        every = client.robots(map_)
        robots = [one["id"] for one in every if one["connected"]]
        apart = [one["id"] for one in every if not one["connected"]]
        if apart:
            errors.print(f"submaps: not connected to the map yet, left out: {', '.join(apart)}", markup=False)
    if not robots:
        fail(f"{map_}: no robot has sent anything yet", INPUT)
    if out is None and len(robots) > 1:
        fail(f"{map_} has {len(robots)} robots ({', '.join(robots)}): choose one with --robot, or give --out", INPUT)
    for one in robots:
        path = out
        if out is not None and len(robots) > 1:
            path = out.with_stem(f"{out.stem}_{one}")
        _write(client.text(f"{path_of(map_, one)}/trajectory?frame=map&format=tum"), path)


def _write(text: str, path: Path | None) -> None:
    if path is None:
        sys.stdout.write(text)
        return
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        fail(f"{path}: cannot be written ({error.strerror})", INPUT)
    print(f"Wrote {path}")
