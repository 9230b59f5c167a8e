"""``submaps experiment``: show what the documents behind this project claim."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.markup import escape

from service.commands.console import FAULT, INPUT, Json, fail, print_json, print_table
from service.commands.plot import check_picture
from service.experiments.registry import REGISTRY, load

if TYPE_CHECKING:
    from service.experiments.base import Experiment, Outcome


def experiment(
    name: Annotated[str | None, typer.Argument(help="Which one; without a name they are listed.")] = None,
    list_: Annotated[bool, typer.Option("--list", help="List the experiments.")] = False,
    runs: Annotated[int | None, typer.Option(min=1, help="How many runs. [default: the experiment's own]")] = None,
    seed: Annotated[int, typer.Option(min=0, help="The seed that all chance comes from.")] = 0,
    out: Annotated[
        Path | None, typer.Option(help="Folder for NAME.png and NAME.csv. [default: this one; with --json, none]")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes; results do not depend on it. [default: one a core]")
    ] = None,
    json: Json = False,
) -> None:
    """Run an experiment: a table, a picture, a CSV, and what was assumed.

    With --json the figures are printed as one object, and files are written only where --out says so.
    """
    if name is None or list_:
        _list(json)
        return
    if name not in REGISTRY:
        fail(f"{name}: no such experiment; there are {', '.join(sorted(REGISTRY))}", INPUT)
    folder = out if json else out or Path()
    if folder is not None:
        _prepare(folder, name)
    _run(_load(name), runs, seed, folder, workers, json)


def _list(json: bool) -> None:
    known = [_load(name) for name in sorted(REGISTRY)]
    if json:
        print_json({"experiments": [{"name": one.name, "about": one.about, "runs": one.runs} for one in known]})
    else:
        print_table(["experiment", "runs", "about"], [[one.name, f"{one.runs:,}", one.about] for one in known])


def _load(name: str) -> Experiment:
    try:
        return load(name)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != "matplotlib":
            raise
        fail(f"{name} needs matplotlib; pip install 'submaps[plot]'", INPUT)


def _prepare(folder: Path, name: str) -> None:
    """Find out before the work starts whether its files can be written; the folder itself is made."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        fail(f"{folder}: cannot be made a folder ({error.strerror})", INPUT)
    check_picture(folder / f"{name}.png")


def _run(chosen: Experiment, runs: int | None, seed: int, folder: Path | None, workers: int | None, json: bool) -> None:
    from service.experiments.report import told
    from service.experiments.runner import WorkerLost, Workers

    try:
        with Workers(runs or chosen.runs, seed, workers=workers, quiet=json) as shared:
            outcome = chosen.run(shared)
    except WorkerLost as error:
        fail(str(error), FAULT)
    files = _write(outcome, chosen.name, folder) if folder is not None else {}
    if json:
        print_json(told(chosen.name, shared, outcome, files))
    else:
        _show(outcome, files)


def _write(outcome: Outcome, name: str, folder: Path) -> dict[str, Path]:
    from service.experiments.report import write_csv, write_picture

    files = {"picture": folder / f"{name}.png", "csv": folder / f"{name}.csv"}
    try:
        write_csv(outcome.series, files["csv"])
        write_picture(outcome, files["picture"])
    except OSError as error:
        fail(f"{folder}: cannot be written ({error.strerror})", INPUT)
    return files


def _show(outcome: Outcome, files: dict[str, Path]) -> None:
    from service.experiments.report import cell

    console = Console(highlight=False)
    console.print(outcome.summary, markup=False)
    print_table(outcome.table.columns, [[escape(cell(value)) for value in row] for row in outcome.table.rows])
    if outcome.assumptions:
        console.print("Assumptions, where the documents leave the choice open:")
        for one in outcome.assumptions:
            console.print(f"  · {one}", markup=False)
    console.print(f"Wrote {' and '.join(str(path) for path in files.values())}", markup=False, soft_wrap=True)
