"""A client of the service's HTTP interface, as far as the command line needs one."""

from __future__ import annotations

from collections.abc import Iterator
from types import TracebackType
from typing import Any
from urllib.parse import quote

import httpx
import orjson

from submaps.config import MapConfig
from submaps.measurements import Batch

COLUMNS = "application/vnd.submaps.columns+json"
_PATIENCE = httpx.Timeout(600.0, connect=5.0)  # a solve of a large map is waited for


class Unreachable(Exception):
    """Nothing answers at the address; the message says what to do."""


class Refused(Exception):
    """The service answered with a fault; the message is the service's own."""

    def __init__(self, status: int, type_: str, message: str) -> None:
        super().__init__(message)
        self.status = status
        self.type = type_


class Client:
    """One connection to a service. Raises ``Unreachable`` and ``Refused``."""

    def __init__(self, url: str) -> None:
        self.url = url.rstrip("/")
        try:
            self._http = httpx.Client(base_url=self.url, timeout=_PATIENCE, trust_env=False)
        except httpx.InvalidURL as error:
            raise Unreachable(f"{url}: not an address ({error}); give one like http://127.0.0.1:8080") from None

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._http.close()

    def request(self, method: str, path: str, body: Any = None, *, type_: str = "application/json") -> Any:
        """Send a request; return the decoded answer."""
        content = None if body is None else orjson.dumps(body, option=orjson.OPT_SERIALIZE_NUMPY)
        headers = {} if body is None else {"content-type": type_}
        try:
            answer = self._http.request(method, path, content=content, headers=headers)
        except httpx.UnsupportedProtocol:
            raise Unreachable(f"{self.url}: not an address; give one like http://127.0.0.1:8080") from None
        except httpx.TimeoutException:
            raise Unreachable(f"{self.url}: no answer in time to {method} {path}") from None
        except httpx.TransportError as error:
            raise Unreachable(
                f"{self.url}: no service answers there ({error}); start one with: submaps serve"
            ) from None
        if answer.is_error:
            raise _refused(answer, f"{method} {path}")
        return orjson.loads(answer.content) if answer.content else None

    def pages(self, path: str, name: str, **query: str) -> Iterator[dict[str, Any]]:
        """Entries of a list, page after page."""
        cursor: str | None = None
        while True:
            given = {**query, "limit": "1000"} | ({} if cursor is None else {"cursor": cursor})
            page = self.request("GET", f"{path}?{httpx.QueryParams(given)}")
            yield from page[name]
            cursor = page["next"]
            if cursor is None:
                return

    def create_map(self, name: str, config: MapConfig) -> None:
        """Create a map for a run's models; all else is the service's default."""
        motion = {"model": config.motion.model, "sigma": config.motion.sigma}
        seen = config.observation
        observation = {"model": seen.model, "sigma": seen.sigma, "mount": seen.mount}
        self.request("POST", "/v1/maps", {"id": name, "motion": motion, "observation": observation})

    def measure(self, map_: str, robot: str, sequence: int, batch: Batch) -> Any:
        """Send one batch as columns; return its acknowledgement."""
        path = f"/v1/maps/{quote(map_, safe='')}/robots/{quote(robot, safe='')}/measurements"
        return self.request("POST", path, columns(sequence, batch), type_=COLUMNS)

    def optimize(self, map_: str) -> Any:
        """Solve the map's atlas and wait for it."""
        return self.request("POST", f"/v1/maps/{quote(map_, safe='')}/optimize?wait=true", {"refine": False})


def columns(sequence: int, batch: Batch) -> dict[str, Any]:
    """A batch as the body of ``application/vnd.submaps.columns+json``."""
    body: dict[str, Any] = {"sequence": sequence, "t": batch.t}
    if batch.control_step.size:
        body["control"] = batch.control
        if batch.control_step.size < batch.steps:
            body["control_step"] = batch.control_step
        if batch.control_covariance is not None:
            body["control_covariance"] = batch.control_covariance
    if batch.observations:
        body["observation"] = {"step": batch.observation_step, "landmark": batch.landmark, "z": batch.z}
        if batch.observation_covariance is not None:
            body["observation"]["covariance"] = batch.observation_covariance
    return body


def _refused(answer: httpx.Response, request: str) -> Refused:
    try:
        problem = orjson.loads(answer.content)
        lines = [problem.get("detail") or problem["title"]]
        lines += [f"{error['path']}: {error['message']}" for error in problem.get("errors") or []]
        return Refused(answer.status_code, str(problem.get("type")), "; ".join(lines))
    except (orjson.JSONDecodeError, AttributeError, KeyError, TypeError):
        detail = f"{request} was answered with {answer.status_code}, not by a Submaps service it seems"
        return Refused(answer.status_code, "", detail)
