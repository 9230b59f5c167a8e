"""Messages about solves, faults and health."""

from __future__ import annotations

from typing import Literal

from pydantic import ConfigDict, Field

from service.wire.base import Wire, example


class FieldError(Wire):
    """One fault of a message."""

    path: str = Field(description="where, such as `steps.3.odometry.dx`")
    message: str = Field(description="what came, and what was expected")


class ProblemAnswer(Wire):
    """A fault (RFC 9457)."""

    model_config = ConfigDict(extra="allow")

    type: str = Field(examples=["invalid-content"])
    title: str
    status: int
    detail: str
    errors: list[FieldError] | None = None


class SolveRequest(Wire):
    """What to solve."""

    model_config = example(refine=False)

    refine: bool = Field(False, description="relinearise inside the sub-maps; not supported yet")


class SolveAnswer(Wire):
    """A finished solve."""

    model_config = example(map_version=13, seconds=0.12, iterations=9, cost=6190.2)

    map_version: int
    seconds: float
    iterations: int
    cost: float = Field(description="of the joined problem, chi-square")


class SolveState(Wire):
    """A solve by its number."""

    model_config = example(number=4, status="done", map_version=13, seconds=0.12, iterations=9, cost=6190.2)

    number: int
    status: Literal["waiting", "running", "done", "failed"]
    map_version: int | None = None
    seconds: float | None = None
    iterations: int | None = None
    cost: float | None = None
    detail: str | None = Field(None, description="why it failed")


class Health(Wire):
    """The process answers."""

    model_config = example(status="ok")

    status: Literal["ok"]


class Readiness(Wire):
    """The service takes requests; ``halted`` lists maps that stopped at a fault."""

    model_config = example(status="ready", maps=3, halted=[])

    status: Literal["ready"]
    maps: int
    halted: list[str]
