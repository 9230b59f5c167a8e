"""A service of one's own: a child process on a free loopback port, its data in a temporary folder."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from service.client import Client, Refused, Unreachable

_START_SECONDS = 180.0  # the very first start may have to compile the kernel
_STOP_SECONDS = 10.0
LISTENING = "Submaps listens on "


class NotStarted(Exception):
    """The child process did not come up; the message holds its last words."""


@contextmanager
def own_service() -> Iterator[str]:
    """Start a service, give its URL when it is ready, and stop it after."""
    with tempfile.TemporaryDirectory(prefix="submaps-") as home:
        log = Path(home) / "log"
        command = [sys.executable, "-m", "service.cli", "serve", "--port", "0", "--data", str(Path(home) / "data")]
        with log.open("w") as out:
            child = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.STDOUT)
        try:
            yield _wait_until_ready(child, log)
        finally:
            _stop(child)


def _wait_until_ready(child: subprocess.Popen[bytes], log: Path) -> str:
    deadline = time.monotonic() + _START_SECONDS
    while time.monotonic() < deadline:
        said = log.read_text(errors="replace")
        if child.poll() is not None:
            raise NotStarted(f"the service ended while starting, with exit code {child.returncode}:\n{said.strip()}")
        lines = [line for line in said.splitlines() if line.startswith(LISTENING)]
        if lines and _ready(lines[0].removeprefix(LISTENING).split()[0]):
            return lines[0].removeprefix(LISTENING).split()[0]
        time.sleep(0.05)
    raise NotStarted(f"the service was not ready after {_START_SECONDS:.0f} s:\n{log.read_text(errors='replace')}")


def _ready(url: str) -> bool:
    try:
        with Client(url) as client:
            client.request("GET", "/readyz")
    except (Unreachable, Refused):
        return False
    return True


def _stop(child: subprocess.Popen[bytes]) -> None:
    child.terminate()
    try:
        child.wait(_STOP_SECONDS)
    except subprocess.TimeoutExpired:
        child.kill()
        child.wait()
