"""What routes share: the engine, names, frames, pages, answers."""

from __future__ import annotations

import base64
import re
from typing import Annotated, Any

import numpy as np
import orjson
from fastapi import Path, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from service.engine import Engine
from service.hosted import Hosted
from service.problems import MEDIA_TYPE, Problem, invalid
from service.wire.base import NAME, Wire

FRAME = r"^(map|odom|submap/(0|[1-9][0-9]{0,8}))$"

MapId = Annotated[str, Path(alias="map", description="a map's id", examples=["park"])]
RobotId = Annotated[str, Path(alias="robot", description="a robot's name", examples=["r1"])]


class Query(BaseModel):
    """Query parameters; unknown ones are refused."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class Page(Query):
    """Which part of a list."""

    limit: int = Field(100, ge=1, le=1000, description="most entries of the page")
    cursor: str | None = Field(None, max_length=200, description="`next` of the page before")


def engine_of(request: Request) -> Engine:
    """Return the engine that serves a request."""
    engine: Engine = request.app.state.engine
    return engine


def hosted_map(request: Request, map_: str) -> Hosted:
    """Return a map; raises ``Problem`` (404, or 503 while recovering)."""
    return engine_of(request).map(map_)


def check_name(path: str, name: str) -> None:
    """Raise ``Problem`` (422) unless ``name`` can be that of a map or robot."""
    if not re.fullmatch(NAME, name):
        raise invalid(path, f"got {name!r}, expected a name like {NAME}")


def cursor_of(kind: str, position: int | None) -> str | None:
    """Return a position in a list as an opaque cursor."""
    if position is None:
        return None
    return base64.urlsafe_b64encode(f"{kind}:{position}".encode()).decode().rstrip("=")


def position_of(kind: str, cursor: str | None) -> int:
    """Return the position that ``cursor_of`` was given, 0 without a cursor.

    Raises ``Problem`` (422) for a cursor of something else.
    """
    if cursor is None:
        return 0
    try:
        text = base64.urlsafe_b64decode(cursor + "=" * (-len(cursor) % 4)).decode()
        named, _, number = text.partition(":")
        if named == kind and number.isdigit():
            return int(number)
    except ValueError:
        pass
    raise invalid("cursor", f"got {cursor!r}, expected `next` of a page of this list")


def json_answer(content: Any, status: int = 200, headers: dict[str, str] | None = None) -> Response:
    """Return content as JSON."""
    # Arrays that are not contiguous are left to `default`.
    body = orjson.dumps(content, default=np.ndarray.tolist, option=orjson.OPT_SERIALIZE_NUMPY)
    return Response(body, status, headers, "application/json")


def problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the documentation of the problems that a route may answer with."""
    return {
        status: {"description": _MEANING[status], "content": {MEDIA_TYPE: {
            "schema": {"$ref": "#/components/schemas/ProblemAnswer"}, "example": _example(status),
        }}}
        for status in (*statuses, 500, 503)
    }  # fmt: skip


def either(in_plane: type[Wire], in_space: type[Wire]) -> dict[int | str, dict[str, Any]]:
    """Return the documentation of an answer that has one form in maps in se2 and another in se3: an example of each."""
    examples = {}
    for space, model in (("se2", in_plane), ("se3", in_space)):
        extra = model.model_config["json_schema_extra"]
        assert isinstance(extra, dict)
        assert isinstance(extra["examples"], list)
        examples[space] = {"value": extra["examples"][0]}
    return {200: {"content": {"application/json": {"examples": examples}}}}


_MEANING = {
    400: "The body is not JSON.",
    404: "There is no such thing.",
    409: "It conflicts with what is there.",
    413: "The body is too large.",
    415: "The body is of a type that is not known.",
    422: "The content is wrong; `errors` says where and why.",
    500: "The service failed.",
    503: "The service is recovering, or cannot write.",
}


def _example(status: int) -> dict[str, Any]:
    problem = Problem(status, _MEANING[status].split(".")[0].lower().replace(" ", "-"), _MEANING[status])
    if status == 422:
        problem = invalid("steps.3.t", "got 0.2, expected a time after the step before")
    example: dict[str, Any] = orjson.loads(problem.body())
    return example
