"""Robots: where they are, and where they have been."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import orjson
from fastapi import APIRouter, Request, Response
from fastapi import Query as QueryParameters
from fastapi.responses import StreamingResponse
from pydantic import Field

from service.api import tracks
from service.api.body import media_type, read_body
from service.api.common import (
    FRAME,
    MapId,
    Page,
    Query,
    RobotId,
    check_name,
    cursor_of,
    either,
    engine_of,
    hosted_map,
    json_answer,
    position_of,
    problems,
)
from service.hosted import Hosted
from service.problems import Problem, invalid, not_found
from service.wire.answers import PoseAnswer, RobotAnswer, RobotList, SpatialPoseAnswer, Trajectory
from service.wire.base import parse
from service.wire.columns import ROWS_TYPE
from service.wire.maps import CONFIG
from service.wire.poses import pose_answer
from service.wire.robots import (
    ROBOT_REQUESTS,
    RobotRequest,
    RobotSettingsAnswer,
    SpatialRobotRequest,
    SpatialRobotSettingsAnswer,
    start_hint,
)
from submaps.atlas.state import RobotState
from submaps.atlas.view import View

router = APIRouter(prefix="/v1/maps/{map}/robots", tags=["robots"])


class PoseQuery(Query):
    """In which frame."""

    frame: str = Field("map", pattern=FRAME, description="`map`, `odom` or `submap/{k}`")


class TrajectoryQuery(PoseQuery):
    """Which trajectory, of which span, in which form."""

    kind: Literal["filtered", "smoothed"] = Field("filtered", description="`smoothed` is not supported yet")
    from_: float | None = Field(None, alias="from", description="s")
    to: float | None = Field(None, description="s")
    format: Literal["json", "tum"] = Field("json", description="JSON, or lines `t x y z qx qy qz qw`")


@router.get("", response_model=RobotList, summary="List robots", responses=problems(404, 422))
def list_robots(request: Request, map_: MapId, page: Annotated[Page, QueryParameters()]) -> Response:
    """List the robots of a map, in the order of their first batches."""
    view = hosted_map(request, map_).view
    robots = view.robots()
    start = position_of("robots", page.cursor)
    end = start + page.limit
    following = end if end < len(robots) else None
    return json_answer({
        "robots": [_answer(view, one) for one in robots[start:end]],
        "next": cursor_of("robots", following),
    })  # fmt: skip


@router.get("/{robot}", response_model=RobotAnswer, summary="Show a robot", responses=problems(404))
def show_robot(request: Request, map_: MapId, robot: RobotId) -> Response:
    """Show a robot, as of its last batch."""
    view = hosted_map(request, map_).view
    return json_answer(_answer(view, _find(view, robot)))


@router.put(
    "/{robot}", response_model=RobotSettingsAnswer | SpatialRobotSettingsAnswer, summary="Set a robot apart",
    responses=problems(400, 404, 409, 413, 415, 422) | either(RobotSettingsAnswer, SpatialRobotSettingsAnswer),
    openapi_extra={"requestBody": {"required": True, "content": {
        ROWS_TYPE: {"schema": {"oneOf": [
            {"$ref": f"#/components/schemas/{form.__name__}"} for form in (RobotRequest, SpatialRobotRequest)
        ]}},
    }}},
)  # fmt: skip
async def configure_robot(request: Request, map_: MapId, robot: RobotId) -> Response:
    """Give a robot models or a start of its own, before its first batch.

    Each of `motion`, `observation` and `start` may be left out: the robot has the map's then, and no
    start. A start is of the map's space: x, y, theta, or x, y, z and a quaternion. A repeat replaces what
    was said before. Once the robot has sent measurements: 409,
    `robot-exists`. The robot is shown and listed from its first batch on.
    """
    engine = engine_of(request)
    hosted = engine.map(map_)
    check_name("robot", robot)
    media_type(request, [ROWS_TYPE])
    space = hosted.core.space
    wanted = parse(ROBOT_REQUESTS[space], await read_body(request), start_hint(space))
    settings = wanted.completed(parse(CONFIG, hosted.config))
    data = settings.model_dump_json().encode()
    await engine.configure(hosted, robot, data, settings.to_core())
    return json_answer({"id": robot, **orjson.loads(data)})


@router.get(
    "/{robot}/pose", response_model=PoseAnswer | SpatialPoseAnswer, response_model_exclude_none=True,
    summary="Where a robot is", responses=problems(404, 409, 422) | either(PoseAnswer, SpatialPoseAnswer),
)  # fmt: skip
async def show_pose(
    request: Request, map_: MapId, robot: RobotId, query: Annotated[PoseQuery, QueryParameters()]
) -> Response:
    """Return a robot's pose with its covariance; 409 where no path of ties leads to the frame.

    A robot whose motion nothing measures has no dead reckoning, so no frame `odom` and no `map_T_odom`.
    """
    hosted = hosted_map(request, map_)
    view = hosted.view
    reckoned = _reckoned(hosted, _find(view, robot))
    if query.frame == "odom" and not reckoned:
        raise _without_motion(robot)
    found = view.pose(robot, query.frame)
    answer: dict[str, Any] = {
        "frame": found.frame,
        "t": found.t,
        **pose_answer(found.pose),
        "covariance": found.covariance,
        "covariance_kind": found.kind,
        "submap": found.submap,
        "map_version": view.version,
    }
    if found.map_T_odom is not None and reckoned:
        answer["map_T_odom"] = pose_answer(found.map_T_odom)
    return json_answer(answer)


@router.get(
    "/{robot}/trajectory", response_model=Trajectory, summary="Where a robot has been",
    responses=problems(404, 409, 422) | {200: {"content": {"text/plain": {
        "example": "0.1 12.5 -3.25 0 0 0 0.247404 0.968912\n",
    }}}},
)  # fmt: skip
def show_trajectory(
    request: Request, map_: MapId, robot: RobotId, query: Annotated[TrajectoryQuery, QueryParameters()]
) -> Response:
    """Stream the poses after each step, as filtered then, with sub-maps where they are now."""
    if query.kind == "smoothed":
        raise invalid("kind", "got 'smoothed', expected 'filtered' (smoothing comes with refinement)")
    hosted = hosted_map(request, map_)
    if not _reckoned(hosted, _find(hosted.view, robot)) and query.frame == "odom":
        raise _without_motion(robot)
    span = (-float("inf") if query.from_ is None else query.from_, float("inf") if query.to is None else query.to)
    stream = tracks.poses(engine_of(request).journal, hosted, robot, query.frame, span)
    if query.format == "tum":
        return StreamingResponse(tracks.as_tum(stream), media_type="text/plain")
    return StreamingResponse(tracks.as_json(stream, robot, query.frame), media_type="application/json")


def _find(view: View, robot: str) -> RobotState:
    for one in view.robots():
        if one.id == robot:
            return one
    raise not_found("robot", robot)


def _reckoned(hosted: Hosted, robot: RobotState) -> bool:
    """Whether a robot has a dead reckoning: something measures its motion."""
    return hosted.models(robot.id).motion.model != "none"


def _without_motion(robot: str) -> Problem:
    return Problem(
        409, "not-connected", f"Robot {robot!r} has no motion model, so no dead reckoning leads from 'odom' to it."
    )


def _answer(view: View, robot: RobotState) -> dict[str, Any]:
    return {
        "id": robot.id,
        "submap": robot.submap,
        "t": robot.t,
        "steps": robot.steps,
        "observations": robot.observations,
        "rejected": robot.rejected,
        "connected": view.connected(robot.number),
        "pose": {"frame": f"submap/{robot.submap}", **pose_answer(robot.pose)},
    }
