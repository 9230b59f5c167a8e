"""Sub-maps, and the graph that ties them together."""

from __future__ import annotations

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
from service.wire.answers import Graph, SubmapDetail, SubmapList, TransformAnswer
from service.wire.poses import point_answer, pose_answer
from submaps.atlas.estimates import SubmapState
from submaps.measurements import as_encounter

router = APIRouter(prefix="/v1/maps/{map}", tags=["atlas"])


class TransformQuery(Query):
    """Between which sub-maps."""

    from_: int = Field(alias="from", ge=0, description="a sub-map", examples=[0])
    to: int = Field(ge=0, description="a sub-map", examples=[3])


@router.get("/submaps", response_model=SubmapList, summary="List sub-maps", responses=problems(404, 422))
def list_submaps(request: Request, map_: MapId, page: Annotated[Page, QueryParameters()]) -> Response:
    """List the sub-maps, oldest first."""
    view = hosted_map(request, map_).view
    start = position_of("submaps", page.cursor)
    end = min(start + page.limit, view.submap_count)
    following = end if end < view.submap_count else None
    return json_answer({
        "submaps": [_answer(view.submap(k)) for k in range(start, end)],
        "next": cursor_of("submaps", following),
    })  # fmt: skip


@router.get("/submaps/{k}", response_model=SubmapDetail, summary="Show a sub-map", responses=problems(404, 422))
def show_submap(
    request: Request, map_: MapId, k: Annotated[int, Path(ge=0, description="a sub-map", examples=[3])]
) -> Response:
    """Show a sub-map with its robot's pose and its landmarks, in its own frame.

    A landmark's first sighting in a sub-map cannot be gated there. It becomes a tie once it agrees
    with the map; `untied` names those that do not.
    """
    view = hosted_map(request, map_).view
    found = view.submap(k)
    robot_pose, covariance = view.local_pose(k)
    return json_answer({
        **_answer(found),
        "robot_pose": {**pose_answer(robot_pose), "covariance": covariance},
        "local_landmarks": [
            {"id": one.id, **point_answer(one.position), "covariance": one.covariance}
            for one in view.local_landmarks(k)
        ],
        "untied": [name for name in view.untied(k) if as_encounter(name) is None],
    })  # fmt: skip


@router.get("/graph", response_model=Graph, summary="Show the graph", responses=problems(404))
def show_graph(request: Request, map_: MapId) -> Response:
    """Show the atlas as a graph: sub-maps, and the exits and ties between them."""
    view = hosted_map(request, map_).view
    names = {robot.number: robot.id for robot in view.robots()}
    return json_answer({
        "map_version": view.version,
        "nodes": [{"id": one.number, "robot": names[one.robot], "active": one.active} for one in view.state.submaps()],
        "edges": [
            {"kind": e.kind, "a": e.a, "b": e.b, "transform": pose_answer(e.transform), "covariance": e.covariance}
            for e in view.edges()
        ],
    })  # fmt: skip


@router.get(
    "/graph/transform", response_model=TransformAnswer, summary="Transform between two sub-maps",
    responses=problems(404, 409, 422),
)  # fmt: skip
def show_transform(request: Request, map_: MapId, query: Annotated[TransformQuery, QueryParameters()]) -> Response:
    """Compose T_from_to along the path of least uncertainty; 409 where there is no path."""
    view = hosted_map(request, map_).view
    transform, covariance, path = view.transform(query.from_, query.to)
    return json_answer({
        "from": query.from_,
        "to": query.to,
        "transform": pose_answer(transform),
        "covariance": covariance,
        "path": list(path),
        "map_version": view.version,
    })  # fmt: skip


def _answer(submap: SubmapState) -> dict[str, Any]:
    return {
        "id": submap.id,
        "robot": submap.robot,
        "active": submap.active,
        "pose": None if submap.pose is None else pose_answer(submap.pose),
        "covariance": submap.covariance,
        "landmarks": submap.landmarks,
        "steps": submap.steps,
        "observations": submap.observations,
        "nis": submap.nis,
        "began": submap.began,
        "ended": submap.ended,
    }
