"""Operations on the atlas: solve it, and see what became of a solve."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Any

from fastapi import APIRouter, Path, Request, Response
from fastapi import Query as QueryParameters
from pydantic import Field, TypeAdapter

from service.api.body import media_type, read_body
from service.api.common import MapId, Query, engine_of, hosted_map, json_answer, problems
from service.hosted import Hosted, Solve
from service.problems import invalid, not_found
from service.wire.base import parse
from service.wire.columns import ROWS_TYPE
from service.wire.operations import SolveAnswer, SolveRequest, SolveState

router = APIRouter(prefix="/v1/maps/{map}", tags=["operations"])

_REQUEST = TypeAdapter(SolveRequest)


class OptimizeQuery(Query):
    """Whether to wait."""

    wait: bool = Field(True, description="answer when the solve is published, rather than at once")


@router.post(
    "/optimize", response_model=SolveAnswer, summary="Solve the atlas",
    responses=problems(400, 404, 413, 415, 422) | {202: {
        "description": "It will be solved; `Location` tells where to ask.", "model": SolveState,
    }},
    openapi_extra={"requestBody": {"required": False, "content": {
        ROWS_TYPE: {"schema": {"$ref": "#/components/schemas/SolveRequest"}},
    }}},
)  # fmt: skip
async def optimize(request: Request, map_: MapId, query: Annotated[OptimizeQuery, QueryParameters()]) -> Response:
    """Solve the atlas, active sub-maps included; calls that come together share one solve."""
    engine = engine_of(request)
    hosted = engine.map(map_)
    body = await read_body(request)
    if body:
        media_type(request, [ROWS_TYPE])
        if parse(_REQUEST, body).refine:
            raise invalid("refine", "got true, expected false (refinement is not supported yet)")
    hosted.check_usable()
    number, done = engine.solver.join_next(hosted)
    if not query.wait:
        location = {"Location": f"/v1/maps/{hosted.id}/solves/{number}"}
        return json_answer(_state(hosted, number), 202, location)
    solve = asdict(await done)
    del solve["number"]
    return json_answer(solve)


@router.get(
    "/solves/{number}", response_model=SolveState, response_model_exclude_none=True,
    summary="Show a solve", responses=problems(404, 422),
)  # fmt: skip
async def show_solve(
    request: Request, map_: MapId, number: Annotated[int, Path(ge=1, description="counted from 1", examples=[1])]
) -> Response:
    """Show what became of a solve; the last 1 000 are kept."""
    return json_answer(_state(hosted_map(request, map_), number))


def _state(hosted: Hosted, number: int) -> dict[str, Any]:
    outcome = hosted.solves.get(number)
    if isinstance(outcome, Solve):
        return {"status": "done", **asdict(outcome)}
    if outcome is not None:
        return {"number": number, "status": "failed", "detail": outcome.detail}
    if number == hosted.begun:
        return {"number": number, "status": "running"}
    if number == hosted.begun + 1 and hosted.waiting:
        return {"number": number, "status": "waiting"}
    raise not_found("solve", number)
