"""Figures for Prometheus: what the engine counted, and how long requests took."""

from __future__ import annotations

import os
import time
from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.engine import Engine

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
BOUNDS = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 1.0, 5.0)  # s


@dataclass
class _Route:
    counts: list[int] = field(default_factory=lambda: [0] * (len(BOUNDS) + 1))
    seconds: float = 0.0


class Requests:
    """An ASGI wrapper that times requests by method, route and status."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self.routes: dict[tuple[str, str, int], _Route] = {}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        began = time.perf_counter()
        status = 500

        async def note(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
            await send(message)

        try:
            await self._app(scope, receive, note)
        finally:
            route = getattr(scope.get("route"), "path", "none")
            key = (scope["method"], route, status)
            one = self.routes.get(key) or self.routes.setdefault(key, _Route())
            seconds = time.perf_counter() - began
            one.seconds += seconds
            one.counts[bisect_left(BOUNDS, seconds)] += 1


def render(engine: Engine, requests: Requests) -> str:
    """Return every figure in Prometheus' text format."""
    return "\n".join([*_engine(engine), *_process(), *_requests(requests), ""])


def _engine(engine: Engine) -> Iterator[str]:
    counters, journal, solver = engine.counters, engine.journal.stats, engine.solver
    figures = [
        ("batches_total", "counter", "batches taken in", counters.batches),
        ("duplicates_total", "counter", "batches that were repeats", counters.duplicates),
        ("steps_total", "counter", "steps taken in", counters.steps),
        ("observations_total", "counter", "observations taken in", counters.observations),
        ("journal_groups_total", "counter", "groups committed", journal.groups),
        ("journal_entries_total", "counter", "entries committed", journal.entries),
        ("journal_syncs_total", "counter", "waits for the disk", journal.syncs),
        ("journal_bytes_total", "counter", "bytes of content written", journal.bytes),
        ("solves_total", "counter", "solves published", solver.solved),
        ("solves_failed_total", "counter", "solves that failed", solver.failed),
        ("solve_seconds_total", "counter", "time spent solving", solver.seconds),
        ("maps", "gauge", "maps served", len(engine.maps)),
        ("maps_halted", "gauge", "maps stopped at a fault", sum(bool(m.halted) for m in engine.maps.values())),
    ]
    for name, kind, text, value in figures:
        yield f"# HELP submaps_{name} {text}\n# TYPE submaps_{name} {kind}\nsubmaps_{name} {value}"


def _process() -> Iterator[str]:
    """What Prometheus' own clients say of a process, under the names that they use."""
    figures = [("cpu_seconds_total", "counter", "processor time of all threads", time.process_time())]
    if (resident := _resident_bytes()) is not None:
        figures.append(("resident_memory_bytes", "gauge", "memory in use", resident))
    for name, kind, text, value in figures:
        yield f"# HELP process_{name} {text}\n# TYPE process_{name} {kind}\nprocess_{name} {value}"


def _resident_bytes() -> int | None:
    """Pages that the process holds, as Linux says; ``None`` elsewhere."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        return None


def _requests(requests: Requests) -> Iterator[str]:
    name = "submaps_request_seconds"
    yield f"# HELP {name} time from request to answer\n# TYPE {name} histogram"
    for (method, route, status), one in sorted(requests.routes.items()):
        labels = f'method="{method}",route="{route}",status="{status}"'
        below = 0
        for bound, count in zip((*map(str, BOUNDS), "+Inf"), one.counts, strict=True):
            below += count
            yield f'{name}_bucket{{{labels},le="{bound}"}} {below}'
        yield f"{name}_sum{{{labels}}} {one.seconds}\n{name}_count{{{labels}}} {below}"
