"""``submaps plot``: draw a map."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.client import Client
from service.commands.console import DEFAULT_URL, INPUT, MapName, Url, check_folder, fail, the_map
from service.exporters.atlas import read_atlas


def plot(
    url: Url = DEFAULT_URL,
    map_: MapName = None,
    out: Annotated[Path | None, typer.Option(help="Picture to write (.png, .svg, .pdf). [default: MAP.png]")] = None,
) -> None:
    """Draw a map: trajectories, sub-map frames, landmarks with 2σ ellipses."""
    check_picture(out or Path("map.png"))
    with Client(url) as client:
        name = the_map(client, map_)
        draw(client, name, out or Path(f"{name}.png"), quiet=False)


def check_picture(path: Path) -> None:
    """Find out before the work starts whether its picture can be drawn."""
    try:
        from matplotlib.figure import Figure  # an optional extra
    except ImportError:
        fail("drawing needs matplotlib; pip install 'submaps[plot]'", INPUT)
    known = Figure().canvas.get_supported_filetypes()
    if path.suffix.lstrip(".").lower() not in known:
        fail(f"{path}: expected a picture's suffix, such as .png, .svg or .pdf", INPUT)
    check_folder(path)


def draw(client: Client, name: str, path: Path, *, quiet: bool) -> None:
    """Read a map and write its picture."""
    from service.exporters import picture  # an optional extra

    try:
        picture.draw(read_atlas(client, name), path)
    except OSError as error:
        fail(f"{path}: cannot be written ({error.strerror})", INPUT)
    if not quiet:
        print(f"Wrote {path}")
