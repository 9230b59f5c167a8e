"""Measurements come in."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response

from service.api.body import media_type, read_body
from service.api.common import MapId, RobotId, check_name, engine_of, problems
from service.wire.columns import COLUMNS_TYPE, ROWS_TYPE, decode
from service.wire.measurements import (
    COLUMNS_EXAMPLE,
    RANGE_BEARING_EXAMPLE,
    ROWS_EXAMPLE,
    Acknowledgement,
)

router = APIRouter(prefix="/v1/maps/{map}/robots/{robot}", tags=["measurements"])

_BODY = {
    "required": True,
    "content": {
        ROWS_TYPE: {
            "schema": {"oneOf": [
                {"$ref": "#/components/schemas/CartesianRows"},
                {"$ref": "#/components/schemas/RangeBearingRows"},
            ]},
            "examples": {
                "cartesian": {"value": ROWS_EXAMPLE},
                "range_bearing": {"value": RANGE_BEARING_EXAMPLE},
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
    robots of the map, which join the robots' maps as common landmarks do.
    """
    engine = engine_of(request)
    hosted = engine.map(map_)
    check_name("robot", robot)
    type_ = media_type(request, [ROWS_TYPE, COLUMNS_TYPE])
    body = await read_body(request)
    # From here to admission nothing else runs on the event loop, so the models are those of its place.
    decoded = decode(type_, body, hosted.models(robot), robot)
    acknowledgement = await engine.ingest(hosted, robot, decoded)
    return Response(acknowledgement, media_type="application/json")
