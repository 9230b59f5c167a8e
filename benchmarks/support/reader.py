"""A server whose one route reads the body and answers a small JSON: what HTTP alone costs.

The same server, protocol and event loop as the service's, and the same path and framework; run as a
process of its own, as the service is.
"""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import orjson
import uvicorn
from fastapi import FastAPI, Request, Response
from starlette.applications import Starlette
from starlette.routing import Route

PATH = "/v1/maps/{map}/robots/{robot}/measurements"
LISTENING = "listens on "


async def read(request: Request) -> Response:
    """Read the body, and say how long it is."""
    body = await request.body()
    return Response(orjson.dumps({"bytes": len(body)}), media_type="application/json")


async def figures(_: Request) -> Response:
    """Say the processor time of this process, as the service does."""
    return Response(f"process_cpu_seconds_total {time.process_time()}\n", media_type="text/plain")


def application(framework: str) -> Starlette:
    """The application with the one route, by FastAPI as the service's routes are, or bare Starlette."""
    if framework == "starlette":
        return Starlette(routes=[Route(PATH, read, methods=["POST"]), Route("/metrics", figures)])
    app = FastAPI()
    app.post(PATH)(read)
    app.get("/metrics")(figures)
    return app


@contextmanager
def reader(framework: str) -> Iterator[str]:
    """Start such a server, give its URL, and stop it after."""
    command = [sys.executable, "-m", "benchmarks.support.reader", framework]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True) as child:
        try:
            assert child.stdout is not None
            line = child.stdout.readline()
            if not line.startswith(LISTENING):
                raise RuntimeError(f"the reader did not start: {line!r}")
            yield line.removeprefix(LISTENING).strip()
        finally:
            child.terminate()


def main() -> None:
    """Serve on a free loopback port, as ``submaps serve`` does."""
    listener = socket.create_server(("127.0.0.1", 0), backlog=2048)
    print(f"{LISTENING}http://127.0.0.1:{listener.getsockname()[1]}", flush=True)
    config = uvicorn.Config(application(sys.argv[1]), http="httptools", access_log=False, log_level="warning")
    uvicorn.Server(config).run(sockets=[listener])


if __name__ == "__main__":
    main()
