"""Maps that find out which landmark an observation is of: over HTTP, as rows and as columns, and replayed."""

from __future__ import annotations

import copy
import json
import uuid
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from service.runtime import Measured, Runtime
from service.wire.base import parse
from service.wire.columns import ROWS_TYPE, decode
from service.wire.maps import MAP_REQUEST
from submaps.config import DEFAULT_GATE, DEFAULT_NEW_GATE
from tests.service.support import (
    COLUMNS_TYPE,
    ODOMETRY_MAP,
    Api,
    Json,
    Server,
    as_columns,
    batches,
    check,
    problem,
    serving,
)
from tests.service.test_recovery import comparable, settled
from tests.service.test_runtime import bits

FOUND_MAP: Json = {**ODOMETRY_MAP, "association": {"method": "joint"}}


def anonymous(rows: Json) -> Json:
    """A batch of rows without the names of landmarks."""
    out = copy.deepcopy(rows)
    for step in out["steps"]:
        for one in step["observations"]:
            del one["landmark"]
    return out


def anonymous_columns(rows: Json) -> Json:
    """The same as columns."""
    out = as_columns(rows)
    del out["observation"]["landmark"]
    return out


@pytest.fixture
def found(server: Server) -> Iterator[Api]:
    """A client of a new map that finds its landmarks."""
    with closing(Api(server.url, f"m{uuid.uuid4().hex[:12]}").make(FOUND_MAP)) as one:
        yield one


def test_rows_and_columns_build_one_map(found: Api, server: Server) -> None:
    """Two sub-maps and more, the circle's landmarks told apart; equal but for how they were sent."""
    drive = batches(4, 15)
    acknowledged = [found.send(anonymous(rows)) for rows in drive]
    with closing(Api(server.url, f"m{uuid.uuid4().hex[:12]}").make(FOUND_MAP)) as other:
        for rows, first in zip(drive, acknowledged, strict=True):
            answer = other.post(anonymous_columns(rows), type_=COLUMNS_TYPE)
            assert answer.status_code == 200, answer.text
            assert {**answer.json(), "map_version": 0} == {**first, "map_version": 0}
        assert comparable(other.everything()) == comparable(found.everything())
    true = [o["landmark"] for rows in drive for step in rows["steps"] for o in step["observations"]]
    names = [name for one in acknowledged for name in one["landmarks"]]
    given: dict[str, set[str]] = {}
    for landmark, name in zip(true, names, strict=True):
        if name is not None:
            given.setdefault(name, set()).add(landmark)
    assert all(len(landmarks) == 1 for landmarks in given.values())
    assert found.get("")["counts"]["submaps"] > 1
    shared = [one for one in found.all_of("landmarks") if len(one["submaps"]) > 1]
    assert len(shared) > 5  # identities go on from one sub-map to the next
    assert found.get("/landmarks/~0")["submaps"][0] == 0


def test_what_is_ambiguous_is_told(found: Api) -> None:
    def step(t: float, *points: tuple[float, float]) -> Json:
        return {"t": t, "observations": [{"x": x, "y": y} for x, y in points]}

    first = found.send({"sequence": 1, "steps": [step(0.0, (3.0, 0.0), (3.0, 4.0))]})
    assert (first["landmarks"], first["rejected"]) == (["~0", "~1"], [])
    second = found.send({"sequence": 2, "steps": [step(0.0, (3.0, 4.05), (3.55, 0.0), (6.0, 0.0))]})
    assert second["landmarks"] == ["~1", None, "~2"]
    (aside,) = second["rejected"]
    assert (aside["step"], aside["observation"], aside["landmark"], aside["reason"]) == (0, 1, "~0", "ambiguous")
    assert aside["nis"] == pytest.approx(0.55**2 / 0.02)
    counts = found.get("")["counts"]
    assert (counts["landmarks"], counts["rejected"], counts["observations"]) == (3, 1, 4)


def test_a_map_tells_the_gates_that_it_keeps(found: Api, api: Api) -> None:
    kept = {"method": "joint", "gate": DEFAULT_GATE, "new_gate": DEFAULT_NEW_GATE}
    assert found.get("")["config"]["association"] == kept
    assert api.get("")["config"]["association"] == {"method": "known", "gate": None}
    assert "landmarks" not in api.send(batches(1, 2)[0])


BAD_MAPS: dict[str, tuple[Json, str, str]] = {
    "an unknown method": ({"method": "nearest"}, "association.method", "'joint'"),
    "a second gate where landmarks are known": ({"method": "known", "new_gate": 0.99}, "association.new_gate", "none"),
    "gates the wrong way round":
        ({"method": "greedy", "gate": 0.99, "new_gate": 0.9}, "association.new_gate", "from the gate's 0.99"),
    "no probability": ({"method": "greedy", "new_gate": 1}, "association.new_gate", "less than 1"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD_MAPS)
def test_bad_maps(server: Server, name: str) -> None:
    association, path, message = BAD_MAPS[name]
    with closing(Api(server.url, f"m{uuid.uuid4().hex[:12]}")) as api:
        answer = api.http.post("/v1/maps", json={"id": api.id, **ODOMETRY_MAP, "association": association})
        first = problem(answer, 422)["errors"][0]
        assert first["path"] == path
        assert message in first["message"]


def test_a_landmark_where_none_is_taken_and_none_where_one_is_needed(found: Api, api: Api) -> None:
    rows = batches(1, 6)[0]
    cases: list[tuple[Api, Any, str, str, str]] = [
        (found, rows, "application/json", "steps.0.observations.0.landmark", 'got "0", expected none'),
        (found, as_columns(rows), COLUMNS_TYPE, "observation.landmark", "association is joint"),
        (api, anonymous(rows), "application/json", "steps.0.observations.0.landmark", "association is known"),
        (api, anonymous_columns(rows), COLUMNS_TYPE, "observation.landmark", "required, but absent"),
    ]
    for one, body, type_, path, message in cases:
        check(one, one.post(body, type_=type_), 422, path, message)
        assert one.get("")["counts"]["steps"] == 0
    named = anonymous(rows)
    named["steps"][3]["observations"][1]["landmark"] = "7"
    check(found, found.post(named), 422, "steps.3.observations.1.landmark", 'got "7"')


@pytest.mark.parametrize("method", ["greedy", "assignment", "joint"])
def test_a_replay_reaches_the_same_bits(method: str) -> None:
    """Two robots by turns, each with landmarks of its own."""
    config = {**ODOMETRY_MAP, "association": {"method": method}}
    core = parse(MAP_REQUEST, json.dumps(config).encode()).to_core()
    live, again = Runtime(core), Runtime(core)
    for number, rows in enumerate(batches(12, 10)):
        body = json.dumps(anonymous(rows)).encode()
        event = Measured(number + 1, f"r{number % 2}", decode(ROWS_TYPE, body, core, "r1", method).batch)
        one, other = live.apply(event), again.apply(event)
        assert one is not None
        assert other is not None
        assert (one.found, one.rejected, one.pose) == (other.found, other.rejected, other.pose)
        assert one.track_pose.tobytes() == other.track_pose.tobytes()
    assert bits(live) == bits(again)
    assert live.view().counts()["landmarks"] > 20


def test_a_restart_finds_the_same_landmarks(tmp_path: Path) -> None:
    rows = [anonymous(one) for one in batches(3, 20)]
    with serving(tmp_path) as server, closing(Api(server.url, "park").make(FOUND_MAP)) as api:
        first = [api.send(one) for one in rows]
        before = settled(api)
        server.kill()
    with serving(tmp_path) as server, closing(Api(server.url, "park")) as api:
        assert api.everything() == before
        assert api.send(rows[2]) == {**first[2], "duplicate": True}
