"""What the service's tests share: a server of their own, and a small world to send to it."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from service.standalone import LISTENING

COLUMNS_TYPE = "application/vnd.submaps.columns+json"
Json = dict[str, Any]

ODOMETRY_MAP: Json = {
    "motion": {"model": "odometry", "sigma": [0.02, 0.01, 0.004]},
    "observation": {"model": "cartesian", "sigma": [0.1, 0.1]},
    "submap": {"max_landmarks": 8},
}
VELOCITY_MAP: Json = {
    "motion": {"model": "velocity", "sigma": [0.05, 0.02]},
    "observation": {"model": "range_bearing", "sigma": [0.1, 0.02], "mount": [0.3, 0.0, 0.1]},
}
BICYCLE_MAP: Json = {
    "motion": {"model": "bicycle", "sigma": [0.05, 0.02], "wheelbase": 1.1, "noise": "density"},
    "observation": {"model": "cartesian", "sigma": [0.1, 0.1]},
}
CAR_MAP: Json = {
    "motion": {"model": "ackermann", "sigma": [0.1, 0.02, 0.05], "wheelbase": 2.83, "encoder_offset": 0.76},
    "observation": {"model": "range_bearing", "sigma": [0.1, 0.02], "mount": [3.78, 0.5, 0.0]},
}


@dataclass
class Server:
    """A server in a process of its own."""

    process: subprocess.Popen[str]
    url: str

    def kill(self) -> None:
        """End the server as a power cut would."""
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()

    def stop(self) -> None:
        """Ask the server to end, and wait until it has."""
        if self.process.poll() is None:
            self.process.terminate()
        self.process.wait(60)


def start(data: Path) -> Server:
    """Start a server on ``data``, and wait until it takes requests."""
    process = subprocess.Popen(
        [sys.executable, "-W", "error", "-m", "service.cli", "serve", "--port", "0", "--data", str(data)],
        stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[2],
    )  # fmt: skip
    assert process.stdout is not None
    with process.stdout as out:
        said = out.readline()
    assert said.startswith(LISTENING), "the server did not start"
    url = said.removeprefix(LISTENING).split()[0]
    for _ in range(3000):
        if httpx.get(f"{url}/readyz").status_code == 200:
            return Server(process, url)
        time.sleep(0.02)
    process.kill()
    raise AssertionError("the server did not become ready")


@contextmanager
def serving(data: Path) -> Iterator[Server]:
    """Give a server on ``data``, and stop it after."""
    server = start(data)
    try:
        yield server
    finally:
        server.stop()


def steps(count: int, seed: int = 0, *, radius: float = 8.0) -> list[Json]:
    """Return steps of a robot that drives circles of 60 steps among numbered landmarks."""
    random = np.random.default_rng(seed)
    angles = np.linspace(0.0, 2 * np.pi, 24, endpoint=False)
    spread = radius + np.where(np.arange(24) % 2, 1.5, -1.5)
    landmarks = np.column_stack([spread * np.cos(angles), spread * np.sin(angles)])
    turn = 2 * np.pi / 60
    made = []
    for k in range(count):
        heading = turn * (k + 1) + np.pi / 2
        at = radius * np.array([np.cos(turn * (k + 1)), np.sin(turn * (k + 1))])
        body = (landmarks - at) @ np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
        noise = random.normal(size=3) * [0.02, 0.01, 0.004]
        near = np.flatnonzero(np.hypot(*body.T) < 4.0)
        seen = body[near] + random.normal(size=(near.size, 2)) * 0.1
        made.append({
            "t": round(0.1 * (k + 1), 6),
            "odometry": {"dx": radius * turn + noise[0], "dy": noise[1], "dtheta": turn + noise[2]},
            "observations": [{"landmark": str(i), "x": x, "y": y}
                             for i, (x, y) in zip(near.tolist(), seen.tolist(), strict=True)],
        })  # fmt: skip
    return made


def batches(count: int, size: int, seed: int = 0) -> list[Json]:
    """Return ``count`` batches of ``size`` steps each, as rows."""
    made = steps(count * size, seed)
    return [{"sequence": i + 1, "steps": made[i * size : (i + 1) * size]} for i in range(count)]


def as_columns(rows: Json) -> Json:
    """Return a batch of rows, each with an odometry, as columns."""
    seen = [(k, o) for k, step in enumerate(rows["steps"]) for o in step.get("observations", ())]
    odometry = [step["odometry"] for step in rows["steps"]]
    return {
        "sequence": rows["sequence"],
        "t": [step["t"] for step in rows["steps"]],
        "control": [[o[name] for o in odometry] for name in ("dx", "dy", "dtheta")],
        "observation": {
            "step": [k for k, _ in seen],
            "landmark": [o["landmark"] for _, o in seen],
            "z": [[o[name] for _, o in seen] for name in ("x", "y")],
        },
    }


class Api:
    """A client that knows one map."""

    def __init__(self, url: str, id_: str) -> None:
        self.http = httpx.Client(base_url=url, timeout=60)
        self.id = id_
        self.root = f"/v1/maps/{id_}"

    def close(self) -> None:
        """Close the connections."""
        self.http.close()

    def make(self, config: Json = ODOMETRY_MAP) -> Api:
        """Make the map."""
        answer = self.http.post("/v1/maps", json={"id": self.id, **config})
        assert answer.status_code == 201, answer.text
        return self

    def get(self, path: str, **params: Any) -> Any:
        """Return what is at a path below the map."""
        answer = self.http.get(self.root + path, params=params)
        assert answer.status_code == 200, answer.text
        return answer.json()

    def post(self, body: Any, robot: str = "r1", type_: str = "application/json") -> httpx.Response:
        """Send measurements."""
        content = body if isinstance(body, bytes) else json.dumps(body).encode()
        return self.http.post(
            f"{self.root}/robots/{robot}/measurements", content=content, headers={"Content-Type": type_}
        )

    def send(self, body: Json, robot: str = "r1") -> Json:
        """Send measurements that are taken in, and return the acknowledgement."""
        answer = self.post(body, robot)
        assert answer.status_code == 200, answer.text
        acknowledgement: Json = answer.json()
        return acknowledgement

    def optimize(self) -> Json:
        """Solve the map."""
        answer = self.http.post(f"{self.root}/optimize")
        assert answer.status_code == 200, answer.text
        solve: Json = answer.json()
        return solve

    def all_of(self, name: str, **params: Any) -> list[Any]:
        """Return a whole list, page by page."""
        found: list[Any] = []
        page = self.get(f"/{name}", **params)
        found += page[name]
        while page["next"]:
            page = self.get(f"/{name}", cursor=page["next"], **params)
            found += page[name]
        return found

    def everything(self) -> Json:
        """Return all that can be asked about the map."""
        robots = self.all_of("robots")

        def frame_of(robot: Json) -> str:
            return "map" if robot is robots[0] else robot["pose"]["frame"]

        return {
            "map": self.get(""),
            "robots": robots,
            "poses": [self.get(f"/robots/{r['id']}/pose", frame=f) for r in robots for f in (frame_of(r), "odom")],
            "trajectories": [self.get(f"/robots/{r['id']}/trajectory", frame=frame_of(r)) for r in robots],
            "landmarks": self.all_of("landmarks"),
            "submaps": [self.get(f"/submaps/{s['id']}") for s in self.all_of("submaps")],
            "graph": self.get("/graph"),
        }


def problem(answer: httpx.Response, status: int) -> Json:
    """Check that an answer is a problem (RFC 9457), and return it."""
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    body: Json = answer.json()
    assert body["status"] == status
    assert {"type", "title", "detail"} <= body.keys()
    return body


def check(api: Api, answer: httpx.Response, status: int, path: str | None, message: str = "") -> None:
    """Check that a batch was refused at ``path``, and that nothing of it is in the map."""
    body = problem(answer, status)
    if path is not None:
        first = body["errors"][0]
        assert first["path"] == path, body
        assert message in first["message"], body
        assert path in body["detail"]
