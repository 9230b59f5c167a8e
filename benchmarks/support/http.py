"""A lean HTTP/1.1 client on asyncio, since the load shares its processors with the service."""

from __future__ import annotations

import asyncio
import ipaddress
import selectors
import socket
from collections.abc import Coroutine
from typing import Any, TypeVar
from urllib.parse import urlsplit

import httptools

T = TypeVar("T")

_MOST_SELECTED = 900  # connections that select() can watch beside the process's other files


class Connection(asyncio.Protocol):
    """One connection that is kept open; one request at a time."""

    def __init__(self) -> None:
        self._answer: asyncio.Future[tuple[int, bytes]] | None = None
        self._transport: asyncio.Transport | None = None
        self._parser = httptools.HttpResponseParser(self)
        self._body: list[bytes] = []

    @classmethod
    async def open(cls, url: str) -> Connection:
        """A connection to the service at ``url``."""
        address = urlsplit(url)
        host, port = address.hostname or "", address.port or 80
        _, connection = await asyncio.get_running_loop().create_connection(cls, host, port)
        return connection

    async def request(self, message: bytes) -> tuple[int, bytes]:
        """Send a whole request; the answer's status and body. Raises ``ConnectionError``."""
        if self._transport is None or self._transport.is_closing():
            raise ConnectionError("the service closed the connection")
        self._answer = asyncio.get_running_loop().create_future()
        self._transport.write(message)
        return await self._answer

    def close(self) -> None:
        """Close it."""
        if self._transport is not None:
            self._transport.close()

    # -- asyncio's and the parser's calls --------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Remember where to write."""
        assert isinstance(transport, asyncio.Transport)
        transport.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._transport = transport

    def connection_lost(self, exc: Exception | None) -> None:
        """Fail what is waited for."""
        if self._answer is not None and not self._answer.done():
            self._answer.set_exception(ConnectionError(f"the service closed the connection ({exc})"))

    def data_received(self, data: bytes) -> None:
        """Read on."""
        self._parser.feed_data(data)

    def on_body(self, body: bytes) -> None:
        """Keep a part of the body."""
        self._body.append(body)

    def on_message_complete(self) -> None:
        """Hand the answer over."""
        body, self._body = b"".join(self._body), []
        if self._answer is not None and not self._answer.done():
            self._answer.set_result((self._parser.get_status_code(), body))


def post(path: str, type_: str, body: bytes) -> bytes:
    """A whole POST request."""
    head = f"POST {path} HTTP/1.1\r\nhost: load\r\ncontent-type: {type_}\r\ncontent-length: {len(body)}\r\n\r\n"
    return head.encode() + body


def get(path: str) -> bytes:
    """A whole GET request."""
    return f"GET {path} HTTP/1.1\r\nhost: load\r\n\r\n".encode()


def run(main: Coroutine[Any, Any, T], connections: int) -> T:
    """Run in an event loop whose timers are exact where so many ``connections`` allow it.

    The default selector rounds a wait up to a whole millisecond, which would count as latency.
    """
    exact = connections < _MOST_SELECTED
    selector = selectors.SelectSelector() if exact else selectors.DefaultSelector()
    with asyncio.Runner(loop_factory=lambda: asyncio.SelectorEventLoop(selector)) as runner:
        return runner.run(main)


def is_loopback(url: str) -> bool:
    """Whether a URL names this machine's loopback interface."""
    host = urlsplit(url).hostname or ""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
