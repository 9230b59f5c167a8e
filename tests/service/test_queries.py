"""Every answer has the form that the contract gives it, and they agree with one another."""

from __future__ import annotations

import math
from contextlib import closing
from urllib.parse import quote

import httpx
import numpy as np
import pytest

from service.wire.answers import (
    Graph,
    LandmarkAnswer,
    LandmarkList,
    PoseAnswer,
    RobotAnswer,
    RobotList,
    SubmapDetail,
    SubmapList,
    Trajectory,
    TransformAnswer,
)
from service.wire.base import Wire
from service.wire.maps import MapAnswer, MapList
from service.wire.measurements import Acknowledgement
from service.wire.operations import SolveAnswer, SolveState
from tests.service.support import ODOMETRY_MAP, Api, Server, batches

STEPS = 150


@pytest.fixture
def driven(api: Api) -> Api:
    """A map with a robot that drove two and a half laps, in several sub-maps, solved."""
    for batch in batches(5, STEPS // 5):
        Acknowledgement.model_validate(api.send(batch))
    SolveAnswer.model_validate(api.optimize())
    return api


@pytest.mark.parametrize(("path", "model"), [
    ("", MapAnswer),
    ("/robots", RobotList),
    ("/robots/r1", RobotAnswer),
    ("/robots/r1/pose", PoseAnswer),
    ("/robots/r1/pose?frame=odom", PoseAnswer),
    ("/robots/r1/pose?frame=submap/0", PoseAnswer),
    ("/robots/r1/trajectory", Trajectory),
    ("/landmarks", LandmarkList),
    ("/landmarks/0", LandmarkAnswer),
    ("/submaps", SubmapList),
    ("/submaps/0", SubmapDetail),
    ("/graph", Graph),
    ("/graph/transform?from=0&to=1", TransformAnswer),
    ("/solves/1", SolveState),
])  # fmt: skip
def test_answers_have_the_form_that_is_documented(driven: Api, path: str, model: type[Wire]) -> None:
    answer = driven.http.get(driven.root + path)
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"] == "application/json"
    model.model_validate_json(answer.content)


def test_a_map_is_answered_as_it_was_made(api: Api) -> None:
    found = api.get("")
    assert found["id"] == api.id
    assert found["config"]["motion"] == ODOMETRY_MAP["motion"]
    assert found["config"]["association"] == {"method": "known", "gate": None}
    assert found["config"]["submap"] == {
        "max_landmarks": 8, "max_heading_sigma": 0.01, "max_position_sigma": 0.15, "min_observed_steps": 5
    }  # fmt: skip
    assert found["counts"]["steps"] == 0
    assert api.all_of("robots") == api.all_of("submaps") == []
    assert api.get("/landmarks")["landmarks"] == []


def test_an_id_is_generated(server: Server) -> None:
    body = {name: ODOMETRY_MAP[name] for name in ("motion", "observation")}
    answer = httpx.post(f"{server.url}/v1/maps", json=body)
    assert answer.status_code == 201
    assert answer.headers["location"] == f"/v1/maps/{answer.json()['id']}"
    assert httpx.get(server.url + answer.headers["location"]).json() == answer.json()


def test_maps_are_listed_page_by_page(server: Server) -> None:
    made = [Api(server.url, f"page-{k}").make() for k in range(5)]
    found: list[str] = []
    page = httpx.get(f"{server.url}/v1/maps", params={"limit": 2}).json()
    while True:
        MapList.model_validate(page)
        assert len(page["maps"]) <= 2
        found += [one["id"] for one in page["maps"] if one["id"].startswith("page-")]
        if len(found) == 3:  # one that was listed goes, and the pages that follow miss nothing
            httpx.delete(f"{server.url}/v1/maps/page-0")
        if not page["next"]:
            break
        page = httpx.get(f"{server.url}/v1/maps", params={"limit": 2, "cursor": page["next"]}).json()
    assert found == [one.id for one in made]
    for one in made:
        one.http.delete(one.root)
        one.close()


def test_counts_and_acknowledgement_agree(driven: Api) -> None:
    found = driven.get("")
    robot = driven.get("/robots/r1")
    assert found["counts"]["robots"] == 1
    assert found["counts"]["steps"] == robot["steps"] == STEPS
    assert found["counts"]["observations"] == robot["observations"]
    assert found["counts"]["landmarks"] == len(driven.all_of("landmarks", limit=7))
    assert found["counts"]["submaps"] == len(driven.all_of("submaps", limit=3)) > 1
    assert found["counts"]["edges"] == len(driven.get("/graph")["edges"])
    assert found["counts"]["bytes"] > 0
    assert found["map_version"] >= 1


def test_a_client_reads_its_own_writes(api: Api) -> None:
    for batch in batches(10, 5):
        acknowledged = api.send(batch)
        assert api.get("/robots/r1/pose", frame=acknowledged["pose"]["frame"])["t"] == acknowledged["pose"]["t"]
        track = api.get("/robots/r1/trajectory", frame="submap/0")["poses"]
        assert track[-1]["t"] == batch["steps"][-1]["t"]
        assert len(track) == 5 * batch["sequence"]


def test_the_pose_in_its_own_submap_is_the_acknowledged_one(driven: Api) -> None:
    robot = driven.get("/robots/r1")
    local = driven.get("/robots/r1/pose", frame=robot["pose"]["frame"])
    for name in ("x", "y", "theta"):
        assert local[name] == pytest.approx(robot["pose"][name], abs=1e-12)
    assert local["covariance_kind"] == "filtered"
    assert "map_T_odom" not in local


def test_frames_close_the_loop(driven: Api) -> None:
    in_map, in_odom = (driven.get("/robots/r1/pose", frame=frame) for frame in ("map", "odom"))
    joint, reckoned = in_map["map_T_odom"], in_odom
    cosine, sine = math.cos(joint["theta"]), math.sin(joint["theta"])
    assert joint["x"] + cosine * reckoned["x"] - sine * reckoned["y"] == pytest.approx(in_map["x"])
    assert joint["y"] + sine * reckoned["x"] + cosine * reckoned["y"] == pytest.approx(in_map["y"])
    assert (in_map["covariance_kind"], in_odom["covariance_kind"]) == ("joined", "dead_reckoning")
    assert np.linalg.eigvalsh(in_map["covariance"]).min() > 0.0


def test_the_trajectory_is_where_the_robot_drove(driven: Api) -> None:
    track = driven.get("/robots/r1/trajectory", frame="map")["poses"]
    assert [round(10 * pose["t"]) for pose in track] == list(range(1, STEPS + 1))
    # The first pose is the origin of `map`; it lies on the circle, heading along it.
    turn = 2 * np.pi / 60 * np.arange(1, STEPS + 1)
    truth = 8.0 * np.column_stack([np.sin(turn), 1.0 - np.cos(turn)])
    error = np.array([[pose["x"], pose["y"]] for pose in track]) - truth
    assert np.sqrt(np.mean(np.sum(error**2, axis=1))) < 1.0


def test_the_trajectory_by_dead_reckoning(driven: Api) -> None:
    track = driven.get("/robots/r1/trajectory", frame="odom")["poses"]
    assert len(track) == len(driven.get("/robots/r1/trajectory")["poses"])
    last = driven.get("/robots/r1/pose", frame="odom")
    assert [track[-1][name] for name in ("t", "x", "y", "theta")] == [last[name] for name in ("t", "x", "y", "theta")]


def test_a_span_of_the_trajectory(driven: Api) -> None:
    track = driven.get("/robots/r1/trajectory", **{"from": 2.95, "to": 6.05})["poses"]
    assert [round(10 * pose["t"]) for pose in track] == list(range(30, 61))
    assert driven.get("/robots/r1/trajectory", **{"from": 1e6})["poses"] == []


def test_the_trajectory_as_tum_lines(driven: Api) -> None:
    track = driven.get("/robots/r1/trajectory")["poses"]
    answer = driven.http.get(f"{driven.root}/robots/r1/trajectory", params={"format": "tum"})
    assert answer.headers["content-type"].startswith("text/plain")
    rows = np.loadtxt(answer.text.splitlines())
    assert rows.shape == (STEPS, 8)
    np.testing.assert_array_equal(rows[:, :3], [[p["t"], p["x"], p["y"]] for p in track])
    np.testing.assert_allclose(2 * np.arctan2(rows[:, 6], rows[:, 7]), [p["theta"] for p in track], atol=1e-12)


def test_landmarks_keep_their_order_while_the_map_grows(api: Api) -> None:
    first, *rest = batches(5, 20)
    api.send(first)
    page = api.get("/landmarks", limit=2)
    found = page["landmarks"]
    for batch in rest:
        api.send(batch)
        page = api.get("/landmarks", limit=2, cursor=page["next"])
        found += page["landmarks"]
    ids = [one["id"] for one in found]
    assert ids == [one["id"] for one in api.all_of("landmarks")][: len(ids)]


def test_landmarks_within_a_box(driven: Api) -> None:
    whole = driven.all_of("landmarks")
    box = (-3.0, 0.0, 6.0, 9.0)
    inside = [one["id"] for one in whole if box[0] <= one["x"] <= box[2] and box[1] <= one["y"] <= box[3]]
    found = driven.all_of("landmarks", bbox=",".join(map(str, box)), limit=2)
    assert [one["id"] for one in found] == inside
    assert 0 < len(inside) < len(whole)


@pytest.mark.parametrize("id_", ["a/b", "tree 7", "50%", "ä→ü", "?x=1&y#z", "%2F"])
def test_any_printable_id_can_be_asked_for(api: Api, id_: str) -> None:
    api.send({"sequence": 1, "steps": [{"t": 1, "observations": [{"landmark": id_, "x": 1.0, "y": 2.0}]}]})
    assert api.get(f"/landmarks/{quote(id_, safe='')}")["id"] == id_


def test_a_submap_shows_what_it_holds(driven: Api) -> None:
    whole = driven.all_of("submaps")
    assert [one["id"] for one in whole] == list(range(len(whole)))
    assert [one["active"] for one in whole] == [False] * (len(whole) - 1) + [True]
    assert sum(one["steps"] for one in whole) == STEPS
    detail = driven.get("/submaps/0")
    assert len(detail["local_landmarks"]) == detail["landmarks"] == whole[0]["landmarks"]
    assert {one["id"] for one in detail["local_landmarks"]} <= {one["id"] for one in driven.all_of("landmarks")}


def test_the_transform_between_submaps(driven: Api) -> None:
    there = driven.get("/graph/transform", **{"from": 0, "to": 2})
    back = driven.get("/graph/transform", **{"from": 2, "to": 0})
    assert there["path"] == back["path"][::-1]
    a, b = there["transform"], back["transform"]
    cosine, sine = math.cos(a["theta"]), math.sin(a["theta"])
    assert a["x"] + cosine * b["x"] - sine * b["y"] == pytest.approx(0.0, abs=1e-9)
    assert a["y"] + sine * b["x"] + cosine * b["y"] == pytest.approx(0.0, abs=1e-9)


STANDING = {"sequence": 1, "steps": [
    {"t": 1.0, "observations": [{"landmark": "a", "x": 5.0, "y": 1.0}]},
    {"t": 2.0, "observations": [{"landmark": "b", "x": 3.0, "y": 0.0}, {"landmark": "a", "x": 8.0, "y": 1.0}]},
]}  # fmt: skip


def test_an_observation_that_is_unlikely_is_flagged(api: Api) -> None:
    acknowledged = api.send(STANDING)
    Acknowledgement.model_validate(acknowledged)
    (flagged,) = acknowledged["flagged"]
    assert (flagged["step"], flagged["observation"], flagged["landmark"]) == (1, 1, "a")
    assert acknowledged["rejected"] == []


def test_a_gate_rejects_and_says_so(server: Server) -> None:
    api = Api(server.url, "gated").make({**ODOMETRY_MAP, "association": {"method": "known", "gate": 0.999}})
    with closing(api):
        (rejected,) = api.send(STANDING)["rejected"]
        assert (rejected["step"], rejected["observation"], rejected["reason"]) == (1, 1, "gate")
        # Two sightings of 0.1 m each that differ by 3 m.
        assert rejected["nis"] == pytest.approx(3.0**2 / (2 * 0.1**2))
        assert api.get("")["counts"]["rejected"] == api.get("/robots/r1")["rejected"] == 1


def test_health(server: Server, api: Api) -> None:
    assert httpx.get(f"{server.url}/healthz").json() == {"status": "ok"}
    ready = httpx.get(f"{server.url}/readyz").json()
    assert (ready["status"], ready["halted"]) == ("ready", [])
    api.send(batches(1, 3)[0])
    text = httpx.get(f"{server.url}/metrics").text
    figures = dict(line.rsplit(" ", 1) for line in text.splitlines() if not line.startswith("#"))
    assert float(figures["submaps_batches_total"]) >= 1
    assert float(figures["submaps_journal_syncs_total"]) >= 1
    assert any("measurements" in name and "_bucket" in name for name in figures)
    assert float(figures["process_cpu_seconds_total"]) > 0
    assert float(figures.get("process_resident_memory_bytes", 2**21)) > 2**20  # absent where the system does not say
