"""Measurements come in."""

from __future__ import annotations

import re

from fastapi import APIRouter, Request, Response
from starlette.types import ASGIApp, Receive, Scope, Send

from service.api.body import media_type, read_body
from service.api.common import MapId, RobotId, check_name, engine_of, problems
from service.api.errors import answer
from service.problems import Problem
from service.wire.bearing import BEARING_EXAMPLE
from service.wire.columns import COLUMNS_TYPE, ROWS, ROWS_TYPE, decode
from service.wire.measurements import (
    COLUMNS_EXAMPLE,
    RANGE_BEARING_EXAMPLE,
    ROWS_EXAMPLE,
    Acknowledgement,
)
from service.wire.spatial import CARTESIAN3D_EXAMPLE, PINHOLE_EXAMPLE, STEREO_EXAMPLE

PATH = "/v1/maps/{map}/robots/{robot}"

router = APIRouter(prefix=PATH, tags=["measurements"])

_TAKEN = re.compile(PATH.replace("{map}", "([^/]+)").replace("{robot}", "([^/]+)") + "/measurements")

_BODY = {
    "required": True,
    "content": {
        ROWS_TYPE: {
            "schema": {"oneOf": [{"$ref": f"#/components/schemas/{rows.__name__}"} for rows in ROWS.values()]},
            "examples": {
                "cartesian": {"value": ROWS_EXAMPLE},
                "range_bearing": {"value": RANGE_BEARING_EXAMPLE},
                "bearing": {"value": BEARING_EXAMPLE},
                "cartesian3d": {"value": CARTESIAN3D_EXAMPLE},
                "stereo": {"value": STEREO_EXAMPLE},
                "pinhole": {"value": PINHOLE_EXAMPLE},
            },
        },
        COLUMNS_TYPE: {
            "schema": {"$ref": "#/components/schemas/Columns"},
            "examples": {"columns": {"value": COLUMNS_EXAMPLE}},
        },
    },
}  # fmt: skip


@router.post(
    "/measurements", response_model=Acknowledgement, summary="Send measurements",
    responses=problems(400, 404, 409, 413, 415, 422), openapi_extra={"requestBody": _BODY},
)  # fmt: skip
async def send_measurements(request: Request, map_: MapId, robot: RobotId) -> Response:
    """Take in a batch of steps of one robot, all of it or none of it.

    A robot exists from its first batch. The answer comes once the batch is on disk, applied, and
    seen by every query. A repeat of a batch gets the first answer, with `duplicate` true.

    A step's control is of the robot's own motion model. Its `encounters` are sightings of other
    robots of the map, which join the robots' maps as common landmarks do; a map in se3 has none.
    """
    return Response(await _take_in(request, map_, robot), media_type="application/json")


async def _take_in(request: Request, map_: str, robot: str) -> bytes:
    """Return the acknowledgement (JSON) of the batch in a request; raises ``Problem``."""
    engine = engine_of(request)
    hosted = engine.map(map_)
    check_name("robot", robot)
    type_ = media_type(request, [ROWS_TYPE, COLUMNS_TYPE])
    body = await read_body(request)
    # From here to admission nothing else runs on the event loop, so the models are those of its place.
    decoded = decode(type_, body, hosted.models(robot), robot, hosted.core.association)
    return await engine.ingest(hosted, robot, decoded)


class _Served:
    """The route as the request's metrics see it."""

    path = f"{PATH}/measurements"


class Direct:
    """An ASGI wrapper that takes measurements in without the framework.

    A robot may send every step by itself, and then routing, dependencies and response classes would
    cost more than all the rest. Other methods and paths, and a root path, are left to the framework.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http" or scope["method"] != "POST" or scope.get("root_path"):
            await self._app(scope, receive, send)
            return
        found = _TAKEN.fullmatch(scope["path"])
        if found is None:
            await self._app(scope, receive, send)
            return
        scope["route"] = _Served
        try:
            body = await _take_in(Request(scope, receive), found[1], found[2])
        except Problem as problem:
            await answer(problem)(scope, receive, send)
            return
        length = str(len(body)).encode()
        headers = [(b"content-length", length), (b"content-type", b"application/json")]
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        await send({"type": "http.response.body", "body": body})
