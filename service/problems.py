"""Problems: every error that a client sees, as RFC 9457 describes it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import orjson

MEDIA_TYPE = "application/problem+json"


class Problem(Exception):
    """An answer other than success: ``status``, a stable ``type``, and what can be done about it.

    ``errors`` holds ``(path, message)`` pairs where a body or a parameter is at fault; ``extra``
    holds further members of the answer, ``headers`` further headers.
    """

    def __init__(
        self,
        status: int,
        type_: str,
        detail: str,
        *,
        errors: Sequence[tuple[str, str]] = (),
        headers: Mapping[str, str] | None = None,
        **extra: Any,
    ) -> None:
        super().__init__(detail)
        self.status = status
        self.type = type_
        self.detail = detail
        self.errors = tuple(errors)
        self.headers = dict(headers or {})
        self.extra = extra

    @property
    def title(self) -> str:
        """The type in words."""
        return self.type.replace("-", " ").capitalize()

    def body(self) -> bytes:
        """Return the JSON body of the answer."""
        answer: dict[str, Any] = {
            "type": self.type,
            "title": self.title,
            "status": self.status,
            "detail": self.detail,
        }
        if self.errors:
            answer["errors"] = [{"path": path, "message": message} for path, message in self.errors]
        return orjson.dumps(answer | self.extra)


def invalid(path: str, message: str) -> Problem:
    """Return the problem of one field whose content is wrong (422)."""
    return Problem(422, "invalid-content", f"{path}: {message}", errors=[(path, message)])


def not_found(what: str, name: object) -> Problem:
    """Return the problem of something that does not exist (404)."""
    return Problem(404, "not-found", f"There is no {what} {name!r}.")
