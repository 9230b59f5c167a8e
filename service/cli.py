"""The command ``submaps``: serve, replay, plot."""

from __future__ import annotations

import errno
import os
import socket
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import orjson
import typer
from pydantic import ValidationError
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from service.client import Client, Refused, Unreachable
from service.datasets import VICTORIA_PARK, Dataset, DatasetError, read_source
from service.exporters.atlas import read_atlas
from service.settings import Settings
from service.standalone import LISTENING, NotStarted, own_service
from submaps.errors import NumericalError

if TYPE_CHECKING:
    from service.replaying import Replayed
    from submaps.alignment import Alignment

DEFAULT_URL = "http://127.0.0.1:8080"
FAULT, INPUT, UNREACHABLE, REFUSED, INTERRUPTED = 1, 2, 3, 4, 130

app = typer.Typer(
    name="submaps",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    help="Large-scale SLAM as a service: bounded sub-maps, joined, with covariances.",
    epilog="Exit codes: 0 done, 1 fault, 2 wrong input, 3 no service answers, 4 the service refused.",
)
errors = Console(stderr=True, highlight=False)

Url = Annotated[str | None, typer.Option(help="Address of a running service; without it, one is started for the run.")]


@app.command()
def serve(
    host: Annotated[str | None, typer.Option(help="Address to listen on. [default: 127.0.0.1]")] = None,
    port: Annotated[int | None, typer.Option(help="Port to listen on; 0 takes a free one. [default: 8080]")] = None,
    data: Annotated[Path | None, typer.Option(help="Folder of the journal. [default: submaps-data]")] = None,
) -> None:
    """Run the service. Each option can be set as SUBMAPS_HOST, SUBMAPS_PORT, SUBMAPS_DATA_DIR too."""
    try:
        settings = Settings.from_environment(os.environ, host=host, port=port, data_dir=data)
    except ValidationError as error:
        _fail("; ".join(f"{'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors()), INPUT)
    listener = _listen(settings.host, settings.port)

    # Only here: the other commands are clients, and start faster without the whole of the service.
    import uvicorn

    from service.app import create_app
    from service.store.base import StoreError

    try:
        application = create_app(settings)
    except (StoreError, OSError) as error:
        _fail(f"{settings.data_dir}: {error}", INPUT)
    address = f"[{settings.host}]" if ":" in settings.host else settings.host
    url = f"http://{address}:{listener.getsockname()[1]}"
    listener.listen(2048)  # whoever reads the next line can connect at once
    print(f"{LISTENING}{url} (data in {settings.data_dir}; documentation at {url}/docs)", flush=True)
    config = uvicorn.Config(
        application, http="httptools", access_log=False, log_level="warning", timeout_graceful_shutdown=10
    )
    uvicorn.Server(config).run(sockets=[listener])


@app.command(name="replay")
def replay_command(
    source: Annotated[str, typer.Argument(help=f"An iSAM text file, or {VICTORIA_PARK} (needs the extra demo).")],
    url: Url = None,
    map_: Annotated[
        str | None, typer.Option("--map", help="Name of the map to create. [default: that of the data]")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
    batch: Annotated[
        bool, typer.Option(help="Compute the batch optimum too, and compare the landmarks with it.")
    ] = True,
    plot: Annotated[Path | None, typer.Option(help="Draw the map into this file (needs the extra plot).")] = None,
) -> None:
    """Replay a recorded run through the service over HTTP, solve the map, and tell how it went."""
    from service.replaying import map_name, replay  # brings in the compiled kernel

    run = read_source(source)
    if plot is not None:
        _check_picture(plot)
    name = map_ or map_name(run)
    with ExitStack() as stack:
        address = url or stack.enter_context(own_service())
        client = stack.enter_context(Client(address))
        with _bar(json) as bar:
            through = bar.add_task("Replaying through HTTP", total=run.columns.steps)
            done = replay(client, run, name, lambda n, _: bar.update(through, completed=n))
            optimum = _compare(run, done, bar) if batch else None
        _tell(done, optimum, json)
        if plot is not None:
            _draw(client, name, plot, quiet=json)


@app.command(name="plot")
def plot_command(
    url: Annotated[str, typer.Option(help="Address of the service.")] = DEFAULT_URL,
    map_: Annotated[str | None, typer.Option("--map", help="Name of the map. [default: the only one]")] = None,
    out: Annotated[Path | None, typer.Option(help="Picture to write (.png, .svg, .pdf). [default: MAP.png]")] = None,
) -> None:
    """Draw a map: trajectories, sub-map frames, landmarks with 2σ ellipses."""
    _check_picture(out or Path("map.png"))
    with Client(url) as client:
        name = map_ or _only_map(client)
        path = out or Path(f"{name}.png")
        _draw(client, name, path, quiet=False)


def main() -> None:
    """Entry point: run a command, and turn what may go wrong into a message and an exit code."""
    try:
        app()
    except DatasetError as error:
        _fail(str(error), INPUT)
    except Unreachable as error:
        _fail(str(error), UNREACHABLE)
    except Refused as error:
        hint = "; choose another name with --map" if error.status == 409 and "exists" in error.type else ""
        _fail(f"the service refused: {error}{hint}", REFUSED)
    except (NotStarted, NumericalError) as error:
        _fail(str(error), FAULT)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


def _fail(message: str, code: int) -> NoReturn:
    errors.print(f"submaps: {message}", style="red", markup=False, soft_wrap=True)
    sys.exit(code)


def _listen(host: str, port: int) -> socket.socket:
    """Bind before anything else starts, so that a port in use is a message and not a log."""
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listener = socket.socket(family, kind)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
    except OSError as error:
        hint = "; another program uses it, choose one with --port" if error.errno == errno.EADDRINUSE else ""
        _fail(f"cannot listen on {host}:{port}: {error.strerror}{hint}", INPUT)
    return listener


def _bar(quiet: bool) -> Progress:
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    return Progress(*columns, console=console, disable=quiet or not console.is_terminal)


def _compare(run: Dataset, done: Replayed, bar: Progress) -> Alignment:
    from service.replaying import against_batch

    solving = bar.add_task("Solving the batch optimum", total=run.columns.steps)
    return against_batch(run, done.points, lambda n, _: bar.update(solving, completed=n))


def _tell(done: Replayed, optimum: Alignment | None, json: bool) -> None:
    told: dict[str, object] = {
        "map": done.map,
        "steps": done.steps,
        "observations": done.observations,
        "landmarks": done.landmarks,
        "submaps": done.submaps,
        "microseconds_per_observation": round(done.microseconds_per_observation, 3),
        "ingest_seconds": round(done.ingest_seconds, 6),
        "solve_seconds": round(done.solve_seconds, 6),
    }
    if optimum is not None:
        told["landmark_rmse"] = optimum.rmse
        told["landmark_rmse_unaligned"] = optimum.rmse_before
    if json:
        print(orjson.dumps(told, option=orjson.OPT_INDENT_2).decode())
        return
    table = Table(title=f"{done.map}, replayed over HTTP", show_header=False, title_justify="left")
    table.add_column(style="bold")
    table.add_column(justify="right")
    for label, value in _rows(done, optimum):
        table.add_row(label, value)
    Console().print(table)


def _rows(done: Replayed, optimum: Alignment | None) -> list[tuple[str, str]]:
    rows = [
        ("steps", f"{done.steps:,}"),
        ("observations", f"{done.observations:,}"),
        ("landmarks", f"{done.landmarks:,}"),
        ("sub-maps", f"{done.submaps:,}"),
        ("an observation, HTTP and journal included", f"{done.microseconds_per_observation:.1f} µs"),
        ("last solve of the atlas", f"{1e3 * done.solve_seconds:.0f} ms"),
    ]
    if optimum is not None:
        rows.append(("landmark RMSE to the batch optimum, aligned", f"{optimum.rmse:.4f} m"))
        rows.append(("the same, as it comes", f"{optimum.rmse_before:.4f} m"))
    return rows


def _only_map(client: Client) -> str:
    names = [one["id"] for one in client.pages("/v1/maps", "maps")]
    if len(names) != 1:
        known = f"it has {len(names)}: {', '.join(names[:10])}" if names else "it has none; try: submaps replay"
        _fail(f"name a map of {client.url} with --map; {known}", INPUT)
    return str(names[0])


def _check_picture(path: Path) -> None:
    """Find out before the work starts whether its picture can be drawn."""
    try:
        from matplotlib.figure import Figure  # an optional extra
    except ImportError:
        _fail("drawing needs matplotlib; pip install 'submaps[plot]'", INPUT)
    known = Figure().canvas.get_supported_filetypes()
    if path.suffix.lstrip(".").lower() not in known:
        _fail(f"{path}: expected a picture's suffix, such as .png, .svg or .pdf", INPUT)
    if not path.absolute().parent.is_dir():
        _fail(f"{path}: no such folder as {path.absolute().parent}", INPUT)


def _draw(client: Client, name: str, path: Path, *, quiet: bool) -> None:
    from service.exporters.picture import draw  # an optional extra

    try:
        draw(read_atlas(client, name), path)
    except OSError as error:
        _fail(f"{path}: cannot be written ({error.strerror})", INPUT)
    if not quiet:
        print(f"Wrote {path}")


if __name__ == "__main__":
    main()
