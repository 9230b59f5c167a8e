"""Reading a request's body: its type, its size."""

from __future__ import annotations

from collections.abc import Sequence

from fastapi import Request
from starlette.requests import ClientDisconnect

from service.problems import Problem

DISCARDED = 3  # times the limit is read and thrown away, so that the client hears the answer


def media_type(request: Request, known: Sequence[str]) -> str:
    """Return the body's content type; raises ``Problem`` (415) where it is not one of ``known``."""
    encoding = _header(request, b"content-encoding", "identity")
    if encoding != "identity":
        raise _unsupported(f"content-encoding {encoding!r}", ["identity"])
    given = _header(request, b"content-type")
    if given in known:
        return given
    type_, _, parameters = given.partition(";")
    type_ = type_.strip().lower()
    charset = parameters.strip().lower().replace('"', "")
    if type_ not in known or charset not in ("", "charset=utf-8", "charset=utf8"):
        raise _unsupported(f"content type {given!r}" if given else "no content type", known)
    return type_


def _unsupported(what: str, known: Sequence[str]) -> Problem:
    return Problem(415, "unsupported-media-type", f"Got {what}, expected {' or '.join(known)}.")


def _header(request: Request, name: bytes, absent: str = "") -> str:
    """Return the first header of a lower-case name."""
    for key, value in request.scope["headers"]:
        if key == name:
            return str(value, "latin-1")
    return absent


async def read_body(request: Request) -> bytes:
    """Return the body; raises ``Problem`` (413) as soon as it is known to be too large."""
    limit: int = request.app.state.settings.max_body_bytes
    stated = _header(request, b"content-length")
    if stated.isdigit() and int(stated) > limit:
        await _discard(request, limit * DISCARDED)
        raise _too_large(limit)
    chunks: list[bytes] = []
    size = 0
    more = True
    while more:
        message = await request.receive()
        if message["type"] == "http.disconnect":
            raise ClientDisconnect
        chunk = message.get("body", b"")
        size += len(chunk)
        if size > limit:
            await _discard(request, limit * DISCARDED)
            raise _too_large(limit)
        chunks.append(chunk)
        more = message.get("more_body", False)
    return chunks[0] if len(chunks) == 1 else b"".join(chunks)


async def _discard(request: Request, most: int) -> None:
    size = 0
    more = True
    while more and size < most:
        message = await request.receive()
        size += len(message.get("body", b""))
        more = message.get("more_body", False)


def _too_large(limit: int) -> Problem:
    return Problem(
        413, "body-too-large", f"The body may be {limit} bytes; send the steps in several batches.",
        headers={"Connection": "close"}, limit=limit,
    )  # fmt: skip
