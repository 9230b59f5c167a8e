"""A client of the service's HTTP interface, as far as the command line needs one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from types import TracebackType
from typing import Any
from urllib.parse import quote

import httpx
import numpy as np
import orjson

from submaps.config import MapConfig, MotionConfig, ObservationConfig
from submaps.measurements import Batch, as_encounter

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
        answer = self._send(method, path, body, type_)
        return orjson.loads(answer.content) if answer.content else None

    def text(self, path: str) -> str:
        """Get an answer that is plain text."""
        return self._send("GET", path, None, "").text

    def _send(self, method: str, path: str, body: Any, type_: str) -> httpx.Response:
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
        return answer

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
        """Create a map with a run's settings, all of them."""
        self.request("POST", "/v1/maps", {"id": name, **settings(config)})

    def robots(self, map_: str) -> list[dict[str, Any]]:
        """What the service says of each robot of a map."""
        return list(self.pages(f"{path_of(map_)}/robots", "robots"))

    def landmarks(self, map_: str) -> list[dict[str, Any]]:
        """The landmarks that have a place in ``map``."""
        return list(self.pages(f"{path_of(map_)}/landmarks", "landmarks", frame="map"))

    def measure(self, map_: str, robot: str, sequence: int, batch: Batch) -> Any:
        """Send one batch as columns; return its acknowledgement."""
        path = f"{path_of(map_, robot)}/measurements"
        return self.request("POST", path, columns(sequence, batch), type_=COLUMNS)

    def optimize(self, map_: str) -> Any:
        """Solve the map's atlas and wait for it."""
        return self.request("POST", f"{path_of(map_)}/optimize?wait=true", {"refine": False})


def path_of(map_: str, robot: str | None = None) -> str:
    """The path of a map, or of one of its robots."""
    path = f"/v1/maps/{quote(map_, safe='')}"
    return path if robot is None else f"{path}/robots/{quote(robot, safe='')}"


def settings(config: MapConfig) -> dict[str, Any]:
    """The settings of a map as a body says them."""
    space = {} if config.space == "se2" else {"space": config.space}
    return {
        **space,
        "motion": _motion(config.motion),
        "observation": _observation(config.observation),
        "filter": config.filter,
        "association": {"method": "known", "gate": config.gate},
        "submap": {
            "max_landmarks": config.max_landmarks,
            "max_heading_sigma": config.max_heading_sigma,
            "max_position_sigma": config.max_position_sigma,
            "min_observed_steps": config.min_observed_steps,
        },
    }


def _motion(motion: MotionConfig) -> dict[str, Any]:
    if motion.model == "none":
        return {"model": "none"}
    vehicle: dict[str, Any] = {} if motion.wheelbase is None else {"wheelbase": motion.wheelbase}
    if motion.encoder_offset:
        vehicle["encoder_offset"] = motion.encoder_offset
    return {"model": motion.model, "sigma": motion.sigma, "noise": motion.noise, **vehicle}


def _observation(seen: ObservationConfig) -> dict[str, Any]:
    body: dict[str, Any] = {"model": seen.model, "sigma": seen.sigma, "mount": seen.mount}
    if seen.camera is not None:
        body["camera"] = {name: value for name, value in asdict(seen.camera).items() if name != "baseline" or value}
    if seen.depth is not None:
        body["depth"] = asdict(seen.depth)
    return body


def columns(sequence: int, batch: Batch) -> dict[str, Any]:
    """A batch as the body of ``application/vnd.submaps.columns+json``."""
    body: dict[str, Any] = {"sequence": sequence, "t": batch.t}
    if batch.control_step.size:
        body["control"] = batch.control
        if batch.control_step.size < batch.steps:
            body["control_step"] = batch.control_step
        if batch.control_covariance is not None:
            body["control_covariance"] = batch.control_covariance
    met = [as_encounter(name) for name in batch.landmark]
    landmarks = [i for i, one in enumerate(met) if one is None]
    if landmarks:
        body["observation"] = _readings(batch, landmarks, "landmark", [batch.landmark[i] for i in landmarks])
    if len(landmarks) < batch.observations:
        others = [i for i, one in enumerate(met) if one is not None]
        body["encounter"] = _readings(batch, others, "robot", [one[0] for one in met if one is not None])
    return body


def _readings(batch: Batch, rows: list[int], of: str, names: list[str]) -> dict[str, Any]:
    """Some of a batch's observations, each of something that has a name."""
    z = np.ascontiguousarray(batch.z[:, rows])
    body: dict[str, Any] = {"step": batch.observation_step[rows], of: names, "z": z}
    if batch.observation_covariance is not None:
        body["covariance"] = batch.observation_covariance[rows]
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
