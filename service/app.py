"""The application: one engine and its routes."""

from __future__ import annotations

import asyncio
import gc
import logging
from collections.abc import AsyncIterator, Iterable
from contextlib import asynccontextmanager
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from fastapi import FastAPI
from pydantic import BaseModel
from pydantic.json_schema import models_json_schema
from starlette.types import ASGIApp

from service.api import atlas, errors, health, ingest, landmarks, maps, operations, robots
from service.engine import Engine
from service.metrics import Requests
from service.settings import Settings
from service.store.sqlite import SqliteJournal
from service.wire.columns import ROWS
from service.wire.maps import MapRequest
from service.wire.measurements import Columns
from service.wire.operations import ProblemAnswer, SolveRequest
from service.wire.robots import RobotRequest, SpatialRobotRequest

# Read and written by the routes themselves, so FastAPI does not know them.
_DOCUMENTED: Iterable[type[BaseModel]] = (
    MapRequest, RobotRequest, SpatialRobotRequest, *ROWS.values(), Columns, SolveRequest, ProblemAnswer,
)  # fmt: skip

log = logging.getLogger(__name__)


def create_app(settings: Settings) -> FastAPI:
    """Return the application; it opens the journal at once, and recovers when it starts to serve.

    Raises ``service.store.base.StoreError`` where the data directory cannot be used.
    """
    engine = Engine(SqliteJournal(settings.data_dir))

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        # In the background: /healthz answers meanwhile, and everything else says why it does not.
        starting = asyncio.create_task(_start(engine))
        starting.add_done_callback(_report)
        yield
        await asyncio.wait([starting])
        await engine.close()

    app = FastAPI(
        title="Submaps", version=_version(), lifespan=lifespan, redirect_slashes=False,
        description="Large-scale SLAM as a service: bounded sub-maps, joined, with covariances.",
        telemetry={"tracing": False, "metrics": False, "logs": False},
    )  # fmt: skip
    app.state.settings = settings
    app.state.engine = engine
    for module in (maps, ingest, robots, landmarks, atlas, operations, health):
        app.include_router(module.router)
    errors.install(app)
    _observe(app)
    _document(app)
    return app


def _observe(app: FastAPI) -> None:
    def wrap(inner: ASGIApp) -> Requests:
        app.state.requests = Requests(inner)
        return app.state.requests  # type: ignore[no-any-return]

    app.add_middleware(ingest.Direct)
    app.add_middleware(wrap)  # the outer one: it sees them all


async def _start(engine: Engine) -> None:
    await engine.start()
    # What is there now stays: libraries, recovered maps. Looked through for garbage again and again,
    # it would stop every thread for a tenth of a second each time.
    gc.collect()
    gc.freeze()


def _report(starting: asyncio.Task[None]) -> None:
    if not starting.cancelled() and (error := starting.exception()):
        log.critical("the service cannot start", exc_info=error)


def _version() -> str:
    try:
        return version("submaps")
    except PackageNotFoundError:
        return "0"


def _document(app: FastAPI) -> None:
    """Complete the OpenAPI document: bodies that routes read for themselves, and problems."""
    original = app.openapi

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            document = original()
            _, ours = models_json_schema(
                [(model, "validation") for model in _DOCUMENTED], ref_template="#/components/schemas/{model}"
            )
            document["components"]["schemas"] |= ours["$defs"]
            for operation in (one for methods in document["paths"].values() for one in methods.values()):
                # FastAPI's own form of a fault, which no route here answers with.
                if "HTTPValidationError" in str(operation["responses"].get("422")):
                    del operation["responses"]["422"]
            for name in ("HTTPValidationError", "ValidationError"):
                document["components"]["schemas"].pop(name, None)
        return original()

    app.openapi = openapi  # type: ignore[method-assign]
