"""What the commands share: exit codes, messages, progress, tables."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, NoReturn

import orjson
import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from service.client import Client

DEFAULT_URL = "http://127.0.0.1:8080"
FAULT, INPUT, UNREACHABLE, REFUSED, INTERRUPTED = 1, 2, 3, 4, 130

errors = Console(stderr=True, highlight=False)

Url = Annotated[str, typer.Option(help="Address of the service.")]
MapName = Annotated[str | None, typer.Option("--map", help="Name of the map. [default: the only one]")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]


def fail(message: str, code: int) -> NoReturn:
    """Say what went wrong, and end with an exit code."""
    errors.print(f"submaps: {message}", style="red", markup=False, soft_wrap=True)
    sys.exit(code)


def bar(quiet: bool) -> Progress:
    """A progress bar, where someone looks on."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    return Progress(*columns, console=console, disable=quiet or not console.is_terminal)


def print_json(told: Any) -> None:
    """Print an answer for programs."""
    print(orjson.dumps(told, option=orjson.OPT_INDENT_2 | orjson.OPT_SERIALIZE_NUMPY).decode())


def print_rows(title: str, rows: Iterable[tuple[str, str]]) -> None:
    """Print labels with their values."""
    table = Table(title=title, show_header=False, title_justify="left")
    table.add_column(style="bold")
    table.add_column(justify="right")
    for label, value in rows:
        table.add_row(label, value)
    Console().print(table)


def print_table(heads: Iterable[str], rows: Iterable[Iterable[str]]) -> None:
    """Print rows under their heads, the first column names them."""
    table = Table()
    for k, head in enumerate(heads):
        table.add_column(head, style="bold" if k == 0 else None, justify="left" if k == 0 else "right")
    for row in rows:
        table.add_row(*row)
    Console().print(table)


def the_map(client: Client, name: str | None) -> str:
    """The map that is named, else the only one of the service."""
    if name is not None:
        return name
    names = [one["id"] for one in client.pages("/v1/maps", "maps")]
    if len(names) != 1:
        known = f"it has {len(names)}: {', '.join(names[:10])}" if names else "it has none; try: submaps replay"
        fail(f"name a map of {client.url} with --map; {known}", INPUT)
    return str(names[0])


def check_folder(path: Path) -> None:
    """Find out before the work starts whether there is a folder to write into."""
    if not path.absolute().parent.is_dir():
        fail(f"{path}: no such folder as {path.absolute().parent}", INPUT)
