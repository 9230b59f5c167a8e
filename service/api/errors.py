"""Every error as ``application/problem+json``."""

from __future__ import annotations

import logging

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import Response
from starlette.exceptions import HTTPException
from starlette.routing import compile_path

from service.problems import MEDIA_TYPE, Problem
from service.wire.base import problem_of
from submaps.errors import NotConnected, SubmapsError, UnknownName

log = logging.getLogger(__name__)

_TYPES = {404: "not-found", 405: "method-not-allowed"}


def install(app: FastAPI) -> None:
    """Make an application answer every error with a problem."""
    app.add_exception_handler(Problem, _problem)
    app.add_exception_handler(HTTPException, _http)
    app.add_exception_handler(RequestValidationError, _validation)
    app.add_exception_handler(SubmapsError, _core)
    app.add_exception_handler(Exception, _unexpected)


def answer(problem: Problem) -> Response:
    """Return a problem as a response."""
    return Response(problem.body(), problem.status, problem.headers, MEDIA_TYPE)


async def _problem(_: Request, error: Exception) -> Response:
    assert isinstance(error, Problem)
    return answer(error)


async def _http(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    headers = dict(error.headers or {})
    detail = f"There is nothing at {request.url.path}."
    if error.status_code == 405:
        headers["Allow"] = ", ".join(_methods(request))
        detail = f"{request.method} is not possible here; {headers['Allow']} is."
    elif error.status_code != 404:
        detail = str(error.detail)
    type_ = _TYPES.get(error.status_code, "http-error")
    return answer(Problem(error.status_code, type_, detail, headers=headers))


def _methods(request: Request) -> list[str]:
    """Return the methods that the documented routes know at a request's path."""
    methods: set[str] = set()
    for template, operations in request.app.openapi()["paths"].items():
        pattern, _, _ = compile_path(template)
        if pattern.match(request.url.path):
            methods |= {method.upper() for method in operations}
    return sorted(methods)


async def _validation(_: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)
    # A location begins with "query" or "path"; the name alone says as much.
    return answer(problem_of([{**e, "loc": e["loc"][1:]} for e in error.errors()]))


async def _core(_: Request, error: Exception) -> Response:
    if isinstance(error, UnknownName):
        return answer(Problem(404, "not-found", f"{error}."))
    if isinstance(error, NotConnected):
        return answer(Problem(409, "not-connected", f"{error}."))
    log.error("the estimator failed", exc_info=error)
    return answer(Problem(500, "estimator-failed", f"{error}."))


async def _unexpected(_: Request, error: Exception) -> Response:
    return answer(Problem(500, "internal-error", f"The service failed: {type(error).__name__}."))
