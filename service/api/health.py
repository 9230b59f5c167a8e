"""Whether the service lives, is ready, and what it has done."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response

from service.api.common import engine_of, json_answer, problems
from service.metrics import CONTENT_TYPE, render
from service.wire.operations import Health, Readiness

router = APIRouter(tags=["health"])


@router.get("/healthz", response_model=Health, summary="Does the process answer")
async def healthz() -> Response:
    """Answer, as long as the process does."""
    return json_answer({"status": "ok"})


@router.get("/readyz", response_model=Readiness, summary="Does the service take requests", responses=problems())
async def readyz(request: Request) -> Response:
    """Answer 200 once every map is recovered and as long as the journal can be written."""
    engine = engine_of(request)
    engine.check_ready()
    halted = [one.id for one in engine.maps.values() if one.halted]
    return json_answer({"status": "ready", "maps": len(engine.maps), "halted": halted})


@router.get(
    "/metrics", response_class=Response, summary="Figures for Prometheus",
    responses={200: {"content": {"text/plain": {"example": "submaps_batches_total 12\n"}}}},
)  # fmt: skip
async def metrics(request: Request) -> Response:
    """Return counts and times in Prometheus' text format."""
    return Response(render(engine_of(request), request.app.state.requests), media_type=CONTENT_TYPE)
