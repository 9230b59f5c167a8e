"""``submaps serve``: run the service."""

from __future__ import annotations

import errno
import os
import socket
from pathlib import Path
from typing import Annotated

import typer
from pydantic import ValidationError

from service.commands.console import INPUT, fail
from service.settings import Settings
from service.standalone import LISTENING


def serve(
    host: Annotated[str | None, typer.Option(help="Address to listen on. [default: 127.0.0.1]")] = None,
    port: Annotated[int | None, typer.Option(help="Port to listen on; 0 takes a free one. [default: 8080]")] = None,
    data: Annotated[Path | None, typer.Option(help="Folder of the journal. [default: submaps-data]")] = None,
) -> None:
    """Run the service. Each option can be set as SUBMAPS_HOST, SUBMAPS_PORT, SUBMAPS_DATA_DIR too."""
    try:
        settings = Settings.from_environment(os.environ, host=host, port=port, data_dir=data)
    except ValidationError as error:
        fail("; ".join(f"{'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors()), INPUT)
    listener = _listen(settings.host, settings.port)

    # Only here: the other commands are clients, and start faster without the whole of the service.
    import uvicorn

    from service.app import create_app
    from service.store.base import StoreError

    try:
        application = create_app(settings)
    except (StoreError, OSError) as error:
        fail(f"{settings.data_dir}: {error}", INPUT)
    address = f"[{settings.host}]" if ":" in settings.host else settings.host
    url = f"http://{address}:{listener.getsockname()[1]}"
    listener.listen(2048)  # whoever reads the next line can connect at once
    print(f"{LISTENING}{url} (data in {settings.data_dir}; documentation at {url}/docs)", flush=True)
    config = uvicorn.Config(
        application, http="httptools", access_log=False, log_level="warning", timeout_graceful_shutdown=10
    )
    uvicorn.Server(config).run(sockets=[listener])


def _listen(host: str, port: int) -> socket.socket:
    """Bind before anything else starts, so that a port in use is a message and not a log."""
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listener = socket.socket(family, kind)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
    except OSError as error:
        hint = "; another program uses it, choose one with --port" if error.errno == errno.EADDRINUSE else ""
        fail(f"cannot listen on {host}:{port}: {error.strerror}{hint}", INPUT)
    return listener
