"""Latencies in percentiles, and what a service says of itself."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import httpx
import numpy as np

PERCENTILES = (50.0, 90.0, 99.0, 99.9)


@dataclass
class Tally:
    """Answers of one kind: seconds each took, counts by status, and how long was counted."""

    latencies: list[float] = field(default_factory=list)
    statuses: Counter[str] = field(default_factory=Counter)
    seconds: float = 0.0

    def add(self, seconds: float, status: int) -> None:
        """Count an answer; only good ones have a latency."""
        self.statuses[str(status)] += 1
        if status < 400:
            self.latencies.append(seconds)

    @property
    def answered(self) -> int:
        """Good answers."""
        return len(self.latencies)

    @property
    def errors(self) -> dict[str, int]:
        """Counts of the other ones, by status or fault."""
        return {status: n for status, n in self.statuses.items() if not status.startswith(("1", "2", "3"))}

    @property
    def rate(self) -> float:
        """Good answers a second."""
        return self.answered / self.seconds if self.seconds else 0.0

    def percentile(self, p: float) -> float:
        """Latency (s) that ``p`` percent stay below."""
        return float(np.percentile(self.latencies, p)) if self.latencies else float("nan")

    def figures(self) -> dict[str, Any]:
        """Everything, latencies in milliseconds."""
        named = {f"p{p:g}_ms": self.percentile(p) * 1e3 for p in PERCENTILES}
        longest = max(self.latencies, default=float("nan")) * 1e3
        return {"answered": self.answered, "rate": self.rate, **named, "max_ms": longest, "errors": self.errors}


def together(tallies: Sequence[Tally]) -> Tally:
    """Several tallies as one."""
    whole = Tally()
    for one in tallies:
        whole.latencies += one.latencies
        whole.statuses += one.statuses
        whole.seconds += one.seconds
    return whole


def metrics(url: str) -> dict[str, float]:
    """The service's figures that have no labels, by name."""
    answer = httpx.get(f"{url}/metrics", trust_env=False).raise_for_status()
    lines = (line.split() for line in answer.text.splitlines() if line and not line.startswith("#") and "{" not in line)
    return {name: float(value) for name, value in lines}
