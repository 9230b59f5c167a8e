"""Landmarks."""

from __future__ import annotations

import math
from typing import Annotated, Any

from fastapi import APIRouter, Path, Request, Response
from fastapi import Query as QueryParameters
from pydantic import Field

from service.api.common import (
    MapId,
    Page,
    Query,
    cursor_of,
    hosted_map,
    json_answer,
    position_of,
    problems,
)
from service.problems import invalid
from service.wire.answers import LandmarkAnswer, LandmarkList
from service.wire.base import MAP_FRAME
from service.wire.poses import point_answer
from submaps.atlas.estimates import LandmarkEstimate

router = APIRouter(prefix="/v1/maps/{map}/landmarks", tags=["landmarks"])

_FRAME = Field("map", pattern=MAP_FRAME, description="`map` or `submap/{k}`")


class LandmarkQuery(Query):
    """In which frame."""

    frame: str = _FRAME


class LandmarksQuery(Page):
    """In which frame, within which box, which part of the list."""

    frame: str = _FRAME
    bbox: str | None = Field(
        None, max_length=200, description="x0,y0,x1,y1 in the frame, m; in se3 at any z", examples=["0,0,50,50"]
    )


@router.get("", response_model=LandmarkList, summary="List landmarks", responses=problems(404, 409, 422))
def list_landmarks(request: Request, map_: MapId, query: Annotated[LandmarksQuery, QueryParameters()]) -> Response:
    """List landmarks with their covariances, in the order of their first sightings.

    Those to which no tie leads from the frame are left out; `not_connected` counts them.
    """
    view = hosted_map(request, map_).view
    start = position_of("landmarks", query.cursor)
    found, following = view.landmarks(start, query.limit, query.frame, _box(query.bbox))
    return json_answer({
        "frame": query.frame,
        "map_version": view.version,
        "not_connected": view.not_connected(query.frame),
        "landmarks": [_answer(one) for one in found],
        "next": cursor_of("landmarks", following),
    })  # fmt: skip


@router.get("/{id:path}", response_model=LandmarkAnswer, summary="Show a landmark", responses=problems(404, 409, 422))
def show_landmark(
    request: Request,
    map_: MapId,
    id_: Annotated[str, Path(alias="id", description="the landmark's id, percent-encoded", examples=["7"])],
    query: Annotated[LandmarkQuery, QueryParameters()],
) -> Response:
    """Show a landmark with its covariance, and the sub-maps that hold it."""
    view = hosted_map(request, map_).view
    found = view.landmark(id_, query.frame)
    return json_answer({**_answer(found), "frame": query.frame, "map_version": view.version})


def _answer(landmark: LandmarkEstimate) -> dict[str, Any]:
    return {
        "id": landmark.id,
        **point_answer(landmark.position),
        "covariance": landmark.covariance,
        "submaps": list(landmark.submaps),
    }


def _box(text: str | None) -> tuple[float, float, float, float] | None:
    if text is None:
        return None
    try:
        x0, y0, x1, y1 = (float(part) for part in text.split(","))
    except ValueError:
        raise invalid("bbox", f"got {text!r}, expected four numbers x0,y0,x1,y1") from None
    if not (math.isfinite(x0 + y0 + x1 + y1) and x0 <= x1 and y0 <= y1):
        raise invalid("bbox", f"got {text!r}, expected finite x0 <= x1 and y0 <= y1")
    return x0, y0, x1, y1
