"""Maps: make, list, show, delete."""

from __future__ import annotations

import secrets
from typing import Annotated, Any

import orjson
from fastapi import APIRouter, Query, Request, Response

from service.api.body import media_type, read_body
from service.api.common import (
    MapId,
    Page,
    cursor_of,
    engine_of,
    hosted_map,
    json_answer,
    position_of,
    problems,
)
from service.hosted import Hosted
from service.wire.base import parse
from service.wire.columns import ROWS_TYPE
from service.wire.maps import MAP_REQUEST, MapAnswer, MapList, MapRequest

router = APIRouter(prefix="/v1/maps", tags=["maps"])


@router.post(
    "", status_code=201, response_model=MapAnswer, summary="Make a map",
    responses=problems(400, 409, 413, 415, 422),
    openapi_extra={"requestBody": {"required": True, "content": {
        ROWS_TYPE: {"schema": {"$ref": f"#/components/schemas/{MapRequest.__name__}"}},
    }}},
)  # fmt: skip
async def create_map(request: Request) -> Response:
    """Make a map; only `motion` and `observation` are required, and a missing `id` is generated."""
    media_type(request, [ROWS_TYPE])
    wanted = parse(MAP_REQUEST, await read_body(request))
    config = wanted.config()
    hosted = await engine_of(request).create(
        wanted.id or secrets.token_hex(6), config.model_dump_json().encode(), config.to_core()
    )
    return json_answer(_answer(hosted), 201, {"Location": f"/v1/maps/{hosted.id}"})


@router.get("", response_model=MapList, summary="List maps", responses=problems(422))
def list_maps(request: Request, page: Annotated[Page, Query()]) -> Response:
    """List the maps, oldest first."""
    engine = engine_of(request)
    engine.check_ready()
    after = position_of("maps", page.cursor)
    found = sorted((one for one in list(engine.maps.values()) if one.key > after), key=lambda one: one.key)
    shown = found[: page.limit]
    last = shown[-1].key if len(found) > len(shown) else None
    return json_answer({"maps": [_answer(one) for one in shown], "next": cursor_of("maps", last)})


@router.get("/{map}", response_model=MapAnswer, summary="Show a map", responses=problems(404))
def show_map(request: Request, map_: MapId) -> Response:
    """Show a map: its configuration, and how much it holds."""
    return json_answer(_answer(hosted_map(request, map_)))


@router.delete("/{map}", status_code=204, summary="Delete a map", responses=problems(404))
async def delete_map(request: Request, map_: MapId) -> Response:
    """Delete a map and all that was sent to it; the id is free then."""
    await engine_of(request).delete(map_)
    return Response(status_code=204)


def _answer(hosted: Hosted) -> dict[str, Any]:
    view = hosted.view
    return {
        "id": hosted.id,
        "config": orjson.loads(hosted.config),
        "counts": view.counts(),
        "map_version": view.version,
    }
