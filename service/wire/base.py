"""What all messages share: strictness, common fields, and how a fault becomes a problem."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, TypeVar

import orjson
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from service.problems import Problem

NAME = "^[a-z0-9][a-z0-9_-]{0,63}$"
MAP_FRAME = r"^(map|submap/(0|[1-9][0-9]{0,8}))$"
LARGEST = 1e9
LARGEST_TURN = 1e5  # rad: up to here sine and cosine are good to an ulp
LATEST = 1e11  # s: room for seconds since 1970, which pass LARGEST
MOST_ERRORS = 20  # listed in one answer


class Wire(BaseModel):
    """A message: no unknown fields, no coercion, finite numbers."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


def example(**fields: Any) -> ConfigDict:
    """Return a model's configuration with one example."""
    return ConfigDict(json_schema_extra={"examples": [fields]})


def _printable(text: str) -> str:
    if not text.isprintable():
        raise ValueError("expected printable characters")
    return text


Name = Annotated[str, Field(pattern=NAME, examples=["park"])]
Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
Turn = Annotated[float, Field(ge=-LARGEST_TURN, le=LARGEST_TURN)]
Seconds = Annotated[float, Field(ge=-LATEST, le=LATEST, description="the robot's own clock, s")]
LandmarkId = Annotated[str, Field(min_length=1, max_length=128, examples=["7"]), AfterValidator(_printable)]
Landmark = Annotated[
    LandmarkId | None,
    Field(description="its id; absent in a map that finds out which landmark an observation is of"),
]
FAIL_FAST = Field(fail_fast=True)
# A wrong list of a million numbers is one error, not a million.
Numbers = Annotated[list[Number], FAIL_FAST]
Indices = Annotated[list[Annotated[int, Field(ge=0)]], FAIL_FAST]
Matrix = Annotated[list[Numbers], FAIL_FAST]
Matrices = Annotated[list[Matrix], FAIL_FAST]

T = TypeVar("T")
Location = tuple[int | str, ...]
Hint = Callable[[Mapping[str, Any]], str | None]


def parse(adapter: TypeAdapter[T], body: bytes, hint: Hint | None = None) -> T:
    """Return a JSON body as a message.

    Raises ``Problem``: 400 where it is not JSON, 422 where its content is wrong. ``hint`` may add to
    the message of one of pydantic's errors.
    """
    try:
        return adapter.validate_json(body)
    except ValidationError as error:
        raise problem_of(error.errors(include_url=False), hint) from None


def problem_of(errors: Sequence[Mapping[str, Any]], hint: Hint | None = None) -> Problem:
    """Return pydantic's errors as a problem that names each field, what came and what was expected."""
    first = errors[0]
    if first["type"] == "json_invalid":
        return Problem(400, "not-json", f"The body is not JSON in UTF-8: {first['msg']}.")
    pairs = [(path(e["loc"]), _message(e, hint)) for e in errors[:MOST_ERRORS]]
    more = f", and {len(errors) - 1} more" if len(errors) > 1 else ""
    where = pairs[0][0] or "the body"
    return Problem(422, "invalid-content", f"{where}: {pairs[0][1]}{more}", errors=pairs)


def path(location: Location) -> str:
    """Return where something is in a message, such as ``steps.3.odometry.dx``."""
    return ".".join(str(part) for part in location)


def _message(error: Mapping[str, Any], hint: Hint | None) -> str:
    message = str(error["msg"]).removeprefix("Value error, ")
    match error["type"]:
        case "missing":
            message = "required, but absent"
        case "extra_forbidden":
            message = "unknown field"
        case _:
            message = f"{message[:1].lower()}{message[1:]}; got {shown(error['input'])}"
    more = hint(error) if hint else None
    return f"{message}; {more}" if more else message


def shown(value: object) -> str:
    """Return a value as a short text."""
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, list | dict) and len(value) > 6:
        return f"{'a list' if isinstance(value, list) else 'an object'} of {len(value)}"
    try:
        text = orjson.dumps(value, default=repr).decode()
    except TypeError:
        text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
