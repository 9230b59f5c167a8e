"""A robot that is set apart from its map's defaults: by what it may bring, until when, and for how long."""

from __future__ import annotations

import asyncio
import json
import math
import uuid
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from service.engine import Engine
from service.problems import Problem
from service.store.sqlite import SqliteJournal
from service.wire.base import parse
from service.wire.columns import ROWS_TYPE, decode
from service.wire.maps import MAP_REQUEST
from service.wire.robots import ROBOTS, RobotSettingsAnswer
from submaps.config import MotionConfig, ObservationConfig, RobotConfig, Start
from submaps.measurements import Batch
from tests.service.support import BICYCLE_MAP, CAR_MAP, ODOMETRY_MAP, VELOCITY_MAP, Api, Json, batches, problem, serving

COVARIANCE = [[0.25, 0.01, 0.0], [0.01, 0.25, 0.0], [0.0, 0.0, 0.01]]
START: Json = {"frame": "map", "x": 1.5, "y": -2.0, "theta": 0.7, "covariance": COVARIANCE}
MOUNT = {"mount": [0.0, 0.0, 0.0]}
# The map's defaults: a robot that drives and sees as in VELOCITY_MAP does neither.
DEFAULTS = {"motion": ODOMETRY_MAP["motion"], "observation": ODOMETRY_MAP["observation"] | MOUNT, "start": None}


def put(api: Api, body: Any, robot: str = "r2") -> httpx.Response:
    """Set a robot apart."""
    return api.http.put(f"{api.root}/robots/{robot}", json=body)


def set_apart(api: Api, body: Json, robot: str = "r2") -> Json:
    """Set a robot apart, and return what it has then."""
    answer = put(api, body, robot)
    assert answer.status_code == 200, answer.text
    RobotSettingsAnswer.model_validate_json(answer.content)
    settings: Json = answer.json()
    return settings


def turning(count: int, sequence: int = 1) -> Json:
    """Return a batch of a robot with the models of VELOCITY_MAP: it goes round in circles of 2 m."""
    steps: list[Json] = []
    for k in range(count):
        t = 0.1 * (k + 1 + (sequence - 1) * count)
        seen = {"landmark": "post", "range": 2.0, "bearing": math.pi / 2 - 0.1}
        steps.append({"t": round(t, 6), "velocity": {"v": 1.0, "omega": 0.5}, "observations": [seen]})
    return {"sequence": sequence, "steps": steps}


def test_what_is_left_out_is_the_maps(api: Api) -> None:
    assert set_apart(api, {}) == {"id": "r2", **DEFAULTS}
    observation = {"model": "range_bearing", "sigma": [0.1, 0.02], "mount": [0.3, 0.0, 0.1]}
    assert set_apart(api, {"observation": observation}) == {"id": "r2", **DEFAULTS, "observation": observation}
    car = CAR_MAP["motion"]
    assert set_apart(api, {"motion": car, "start": START}) == {"id": "r2", **DEFAULTS, "motion": car, "start": START}
    assert set_apart(api, {"start": None, "motion": None}) == {"id": "r2", **DEFAULTS}


def test_a_robot_exists_from_its_first_batch_whatever_was_said_of_it(api: Api) -> None:
    set_apart(api, {"start": START}, "r1")
    problem(api.http.get(f"{api.root}/robots/r1"), 404)
    problem(api.http.get(f"{api.root}/robots/r1/pose"), 404)
    assert api.all_of("robots") == []
    assert api.get("")["counts"]["robots"] == 0
    api.send(batches(1, 3)[0], "r1")
    assert api.get("/robots/r1")["steps"] == 3
    refused = problem(put(api, {"start": START}, "r1"), 409)
    assert refused["type"] == "robot-exists"
    assert "first batch" in refused["detail"]


def test_a_robot_of_its_own_drives_and_sees_by_its_own_models(api: Api) -> None:
    models = {name: VELOCITY_MAP[name] for name in ("motion", "observation")}
    set_apart(api, models)
    with closing(Api(str(api.http.base_url), f"m{uuid.uuid4().hex[:12]}").make(VELOCITY_MAP)) as alone:
        for sequence in (1, 2):
            api.send(batches(2, 10)[sequence - 1], "r1")  # the map's own models, in between
            one, other = api.send(turning(10, sequence), "r2"), alone.send(turning(10, sequence), "r2")
            for name in ("x", "y", "theta"):
                assert one["pose"][name] == other["pose"][name]
        (wrong,) = problem(api.post({**turning(1, 3), "steps": batches(3, 10)[2]["steps"]}, "r2"), 422)["errors"][:1]
        assert wrong["path"].startswith("steps.0.observations.0")
        assert "velocity (v, omega)" in wrong["message"]
        assert problem(api.post(turning(10, 3), "r1"), 422)["errors"][0]["message"].count("odometry")
        mine, theirs = (one.get("/robots/r2/pose", frame="odom") for one in (api, alone))
        assert mine["covariance"] == theirs["covariance"]


def test_a_start_in_a_submap_that_exists(api: Api) -> None:
    in_submap = {"start": START | {"frame": "submap/0"}}
    assert problem(put(api, in_submap), 404)["type"] == "not-found"
    api.send(batches(1, 3)[0], "r1")
    assert set_apart(api, in_submap)["start"]["frame"] == "submap/0"
    problem(put(api, {"start": START | {"frame": "submap/99"}}), 404)
    problem(api.http.put("/v1/maps/none/robots/r2", json={}), 404)


def changed(**fields: Any) -> Json:
    """Return a start with some fields replaced."""
    return {"start": START | fields}


BAD: dict[str, tuple[Any, str, str]] = {
    "an unknown field": ({"color": "red"}, "color", "unknown field"),
    "a filter of its own": ({"filter": "standard"}, "filter", "unknown field"),
    "not an object": ([], "", "object"),
    "an unknown motion": ({"motion": {"model": "tracks", "sigma": [1, 1]}}, "motion", "tracks"),
    "a motion in part": ({"motion": {"model": "velocity"}}, "motion.velocity.sigma", "required"),
    "an encoder ahead of the car":
        ({"motion": CAR_MAP["motion"] | {"encoder_offset": 3.0}}, "motion.encoder_offset", "wheelbase of 2.83"),
    "an observation's sigma 0":
        ({"observation": {"model": "cartesian", "sigma": [0, 1]}}, "observation.sigma.0", "greater"),
    "a start in part": ({"start": {"frame": "map", "x": 1.0}}, "start.y", "required"),
    "a start nowhere": (changed(x=1e10), "start.x", "less than"),
    "a start in odom": (changed(frame="odom"), "start.frame", "pattern"),
    "a start in no frame": (changed(frame="submap/-1"), "start.frame", "pattern"),
    "a start of unknown covariance": (changed(covariance=None), "start.covariance", "valid array"),
    "a covariance of two rows": (changed(covariance=COVARIANCE[:2]), "start.covariance", "3 lists of 3"),
    "a ragged covariance": (changed(covariance=[[1, 0, 0], [0, 1], [0, 0, 1]]), "start.covariance", "3 lists of 3"),
    "a covariance of 0": (changed(covariance=[[0.0] * 3] * 3), "start.covariance", "positive definite"),
    "a singular covariance": (changed(covariance=[[1.0] * 3] * 3), "start.covariance", "positive definite"),
    "a covariance that is not symmetric":
        (changed(covariance=[[1, 0.1, 0], [0.2, 1, 0], [0, 0, 1]]), "start.covariance", "symmetric"),
    "a covariance that is not a number":
        (changed(covariance=[[1, 0, 0], [0, "1", 0], [0, 0, 1]]), "start.covariance.1.1", "valid number"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_settings(api: Api, name: str) -> None:
    body, path, message = BAD[name]
    set_apart(api, {"motion": VELOCITY_MAP["motion"]})
    found = problem(put(api, body), 422)
    assert found["errors"][0]["path"] == path
    assert message in found["errors"][0]["message"]
    # What was said before stands.
    assert api.send({"sequence": 1, "steps": [{"t": 1.0, "velocity": {"v": 1.0, "omega": 0.0}}]}, "r2")["steps"] == 1


def test_bad_requests(api: Api) -> None:
    assert problem(put(api, {}, "R 2"), 422)["errors"][0]["path"] == "robot"
    path = f"{api.root}/robots/r2"
    problem(api.http.put(path, content=b"{", headers={"Content-Type": "application/json"}), 400)
    problem(api.http.put(path, content=b"{}", headers={"Content-Type": "text/plain"}), 415)
    answer = api.http.delete(path)
    problem(answer, 405)
    assert answer.headers["allow"] == "GET, PUT"


def test_settings_come_back_bit_for_bit() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        x, y, theta, *root = rng.normal(size=12) * 10.0 ** rng.integers(-3, 4)
        covariance = (np.reshape(root, (3, 3)) @ np.reshape(root, (3, 3)).T + np.eye(3)).tolist()
        start = {"frame": "submap/7", "x": x, "y": y, "theta": theta, "covariance": covariance}
        body = {"motion": CAR_MAP["motion"], "observation": CAR_MAP["observation"], "start": start}
        settings = parse(ROBOTS["se2"], json.dumps(body).encode())
        again = parse(ROBOTS["se2"], settings.model_dump_json().encode())
        assert again == settings
        assert again.to_core() == settings.to_core()


def test_a_restart_remembers(tmp_path: Path) -> None:
    with serving(tmp_path) as server, closing(Api(server.url, "park").make()) as api:
        models = {name: VELOCITY_MAP[name] for name in ("motion", "observation")}
        set_apart(api, {"motion": BICYCLE_MAP["motion"]}, "r3")
        set_apart(api, models, "r2")
        for sequence, batch in enumerate(batches(6, 10), 1):
            api.send(batch, "r1")
            api.send(turning(10, sequence), "r2")
            if sequence == 3:
                set_apart(api, {"motion": VELOCITY_MAP["motion"]}, "r3")
        api.optimize()
        everything = settled(api)
        server.kill()
    with serving(tmp_path) as server, closing(Api(server.url, "park")) as api:
        assert api.everything() == everything
        assert api.send(turning(10, 6), "r2")["duplicate"] is True
        assert api.send(turning(10, 7), "r2")["sequence"] == 7
        assert problem(put(api, models, "r2"), 409)["type"] == "robot-exists"
        # The last that was said before the first batch holds, and more may be said until then.
        steps = [{"t": 1.0, "velocity": {"v": 1.0, "omega": 0.0}}]
        problem(api.post({"sequence": 1, "steps": [{"t": 1.0, "bicycle": {"speed": 1.0, "steer": 0.0}}]}, "r3"), 422)
        set_apart(api, {"motion": VELOCITY_MAP["motion"], "start": START}, "r3")
        assert api.send({"sequence": 1, "steps": steps}, "r3")["steps"] == 1
        api.http.delete(api.root)
        api.make()
        assert set_apart(api, {}, "r2") == {"id": "r2", **DEFAULTS}
        assert api.send(batches(1, 3)[0], "r2")["sequence"] == 1


def settled(api: Api) -> Json:
    """Return everything about a map once no solve is on its way."""
    everything = api.everything()
    while (again := api.everything()) != everything:
        everything = again
    return everything


# -- the order of what comes at once -------------------------------------------------------------

CONFIG = parse(MAP_REQUEST, json.dumps(ODOMETRY_MAP).encode())
OWN = RobotConfig(
    MotionConfig("velocity", (0.05, 0.02)), ObservationConfig("range_bearing", (0.1, 0.02)),
    Start("map", (1.0, 2.0, 0.5), ((0.25, 0.0, 0.0), (0.0, 0.25, 0.0), (0.0, 0.0, 0.01))),
)  # fmt: skip
DATA = json.dumps({
    "motion": {"model": "velocity", "sigma": [0.05, 0.02]},
    "observation": {"model": "range_bearing", "sigma": [0.1, 0.02]},
    "start": {"frame": "map", "x": 1.0, "y": 2.0, "theta": 0.5,
              "covariance": [[0.25, 0, 0], [0, 0.25, 0], [0, 0, 0.01]]},
}).encode()  # fmt: skip


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, object]]:
    """What reaches the estimator, in order."""
    from submaps.mapper import Mapper

    found: list[tuple[str, object]] = []
    configure, apply = Mapper.configure, Mapper.apply

    def note_configure(self: Mapper, robot: str, own: RobotConfig) -> None:
        found.append((robot, own))
        configure(self, robot, own)

    def note_apply(self: Mapper, robot: str, batch: Batch) -> Any:
        found.append((robot, batch.control.shape[0]))
        return apply(self, robot, batch)

    monkeypatch.setattr(Mapper, "configure", note_configure)
    monkeypatch.setattr(Mapper, "apply", note_apply)
    return found


def with_engine(path: Path, test: Callable[[Engine], Any]) -> None:
    """Run a test with an engine on the journal at ``path``."""

    async def main() -> None:
        engine = Engine(SqliteJournal(path))
        await engine.start()
        try:
            await test(engine)
        finally:
            await engine.close()

    asyncio.run(main())


def test_settings_on_their_way_count_for_the_batch_that_follows(tmp_path: Path, seen: list[tuple[str, object]]) -> None:
    async def live(engine: Engine) -> None:
        hosted = await engine.create("park", CONFIG.config().model_dump_json().encode(), CONFIG.to_core())
        assert hosted.models("r2") is hosted.core
        setting = asyncio.create_task(engine.configure(hosted, "r2", DATA, OWN))
        await asyncio.sleep(0)  # under way, and not yet in the journal
        assert not setting.done()
        body = json.dumps(turning(2)).encode()
        sending = engine.ingest(hosted, "r2", decode(ROWS_TYPE, body, hosted.models("r2"), "r2"))
        sent = asyncio.create_task(sending)
        await asyncio.sleep(0)
        with pytest.raises(Problem) as refused:  # the batch is under way too
            await engine.configure(hosted, "r2", DATA, OWN)
        assert (refused.value.status, refused.value.type) == (409, "robot-exists")
        await asyncio.gather(setting, sent)

    async def replayed(engine: Engine) -> None:
        assert engine.maps["park"].models("r2") == OWN
        with pytest.raises(Problem, match="first batch"):
            await engine.configure(engine.maps["park"], "r2", DATA, OWN)

    with_engine(tmp_path, live)
    live_order = list(seen)
    assert live_order == [("r2", OWN), ("r2", 2)]
    seen.clear()
    with_engine(tmp_path, replayed)
    assert seen == live_order


def test_a_deleted_map_takes_no_settings(tmp_path: Path) -> None:
    async def test(engine: Engine) -> None:
        hosted = await engine.create("park", CONFIG.config().model_dump_json().encode(), CONFIG.to_core())
        await engine.delete("park")
        with pytest.raises(Problem) as gone:
            await engine.configure(hosted, "r2", DATA, OWN)
        assert gone.value.status == 404

    with_engine(tmp_path, test)


def test_settings_that_the_journal_lost_are_not_acknowledged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError("no space left")

    async def test(engine: Engine) -> None:
        hosted = await engine.create("park", CONFIG.config().model_dump_json().encode(), CONFIG.to_core())
        monkeypatch.setattr(engine.journal, "_insert", full)
        with pytest.raises(Problem) as lost:
            await engine.configure(hosted, "r2", DATA, OWN)
        assert (lost.value.status, lost.value.type) == (503, "journal-failed")
        monkeypatch.undo()

    async def started_again(engine: Engine) -> None:
        assert engine.maps["park"].models("r2") is engine.maps["park"].core

    with_engine(tmp_path, test)
    with_engine(tmp_path, started_again)
