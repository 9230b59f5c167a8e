"""Several robots on one map, each with its vehicle: they meet, and what they saw of one another is gated."""

from __future__ import annotations

import math
import uuid
from collections.abc import Callable, Iterator
from contextlib import closing

import numpy as np
import pytest
from numpy.typing import NDArray

from service.wire.answers import LandmarkList, RobotList, SubmapDetail
from service.wire.measurements import Acknowledgement
from tests.service.support import BICYCLE_MAP, CAR_MAP, COLUMNS_TYPE, ODOMETRY_MAP, Api, Json, Server, problem

Make = Callable[[Json], Api]


@pytest.fixture
def make(server: Server) -> Iterator[Make]:
    """Makes maps, and closes their clients."""
    made: list[Api] = []

    def one(config: Json) -> Api:
        made.append(Api(server.url, f"m{uuid.uuid4().hex[:12]}").make(config))
        return made[-1]

    yield one
    for api in made:
        api.close()


def rotation(angle: float) -> NDArray[np.float64]:
    """Return the rotation by an angle."""
    return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])


@pytest.mark.parametrize(("config", "model"), [(BICYCLE_MAP, "bicycle"), (CAR_MAP, "ackermann")])
def test_a_vehicle_drives_its_circle(make: Make, config: Json, model: str) -> None:
    """With speed and steer held it turns about a point, by the same angle in each step."""
    motion, steer, moved, count = config["motion"], 0.3, 2.0 * 0.01, 500
    if model == "bicycle":  # chords of the front wheel's circle: p_n = sum R(k turn) chord = (1 - R(n turn)) centre
        turn = moved * math.sin(steer) / motion["wheelbase"]
        chord = moved * np.array([math.cos(steer), math.sin(steer)])
        centre = np.linalg.solve(np.eye(2) - rotation(turn), chord)
    else:  # the encoder's wheel is nearer to the middle than that of the axle
        radius = motion["wheelbase"] / math.tan(steer)
        turn, centre = moved / (radius - motion["encoder_offset"]), np.array([0.0, radius])
    api = make(config)
    rows = {"sequence": 1, "steps": [{"t": 0.0}] + [
        {"t": 0.01 * (k + 1), model: {"speed": 2.0, "steer": steer}} for k in range(count)]}  # fmt: skip
    columns = {"sequence": 2, "t": [0.01 * (k + 1) for k in range(count, 2 * count)],
               "control": [[2.0] * count, [steer] * count]}  # fmt: skip
    for sent, body in enumerate((rows, columns), 1):
        api.post(body, type_="application/json" if body is rows else COLUMNS_TYPE).raise_for_status()
        found = api.get("/robots/r1/pose", frame="odom")
        angle = turn * count * sent
        expected = centre - rotation(angle) @ centre
        assert [found["x"], found["y"]] == pytest.approx(expected.tolist(), abs=1e-9)
        assert math.remainder(found["theta"] - angle, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)
        assert np.linalg.eigvalsh(found["covariance"]).min() >= -1e-12


def meeting(api: Api) -> None:
    """Have r1 stand at the origin and see r2 pass, from (5, -5) to (5, 5) along y, among its own landmarks."""
    watched = [
        {"t": float(k), "observations": [{"landmark": "here", "x": 2.0, "y": 1.0}],
         "encounters": [{"robot": "r2", "x": 5.0, "y": k - 5.0}]}
        for k in range(11)
    ]  # fmt: skip
    passed = [
        {"t": float(k), **({"odometry": {"dx": 1.0, "dy": 0.0, "dtheta": 0.0}} if k else {}),
         "observations": [{"landmark": "there", "x": 6.0 - k, "y": -2.0}, {"landmark": "far", "x": 9.0 - k, "y": 3.0}]}
        for k in range(11)
    ]  # fmt: skip
    for robot, steps in (("r1", watched), ("r2", passed)):
        acknowledged = api.send({"sequence": 1, "steps": steps}, robot)
        assert acknowledged["observations"] == 22
        assert acknowledged["rejected"] == []


def test_robots_that_see_one_another_are_one_component_after_the_next_solve(make: Make) -> None:
    api = make(ODOMETRY_MAP)
    before = [{"t": -1.0, "observations": [{"landmark": "there", "x": 1.0, "y": 1.0}]}]
    with closing(make(ODOMETRY_MAP)) as apart:  # the same two, and they do not see one another
        for robot in ("r1", "r2"):
            apart.send({"sequence": 1, "steps": [{**before[0], "observations": [
                {"landmark": robot, "x": 1.0, "y": 1.0}]}]}, robot)  # fmt: skip
        apart.optimize()
        assert [robot["connected"] for robot in apart.all_of("robots")] == [True, False]
        found = apart.get("/landmarks")
        LandmarkList.model_validate(found)
        assert ([one["id"] for one in found["landmarks"]], found["not_connected"]) == (["r1"], 1)
        found = apart.get("/landmarks", frame="submap/1")
        assert ([one["id"] for one in found["landmarks"]], found["not_connected"]) == (["r2"], 1)
        problem(apart.http.get(f"{apart.root}/robots/r2/pose"), 409)
        assert apart.get("/robots/r2")["connected"] is False
    meeting(api)
    api.optimize()
    RobotList.model_validate(api.get("/robots"))
    assert [robot["connected"] for robot in api.all_of("robots")] == [True, True]
    found = api.get("/landmarks")
    assert ({one["id"] for one in found["landmarks"]}, found["not_connected"]) == ({"here", "there", "far"}, 0)
    assert api.get("")["counts"]["landmarks"] == 3  # sightings of robots are none
    detail = api.get("/submaps/1")
    SubmapDetail.model_validate(detail)
    assert ({one["id"] for one in detail["local_landmarks"]}, detail["untied"]) == ({"there", "far"}, [])
    pose = api.get("/robots/r2/pose")
    assert [pose["x"], pose["y"], pose["theta"]] == pytest.approx([5.0, 5.0, math.pi / 2], abs=0.05)
    there = api.get("/landmarks/there")
    assert [there["x"], there["y"]] == pytest.approx([7.0, 1.0], abs=0.1)


@pytest.mark.parametrize("gate", [0.999, None])
def test_a_sighting_of_a_robot_that_does_not_fit_is_told_as_one(make: Make, gate: float | None) -> None:
    api = make({**ODOMETRY_MAP, "association": {"method": "known", "gate": gate}})
    a = [{"landmark": "a", "x": 5.0, "y": 1.0}]
    steps = [
        {"t": 1.0, "observations": a},
        {"t": 2.0, "observations": [*a, {"landmark": "b", "x": 3.0, "y": 0.0}, {"landmark": "a", "x": 8.0, "y": 1.0}],
         "encounters": [{"robot": "r3", "x": 2.0, "y": 2.0}, {"robot": "r2", "x": 3.0, "y": 0.0},
                        {"robot": "r2", "x": 6.0, "y": 0.0}]},
    ]  # fmt: skip
    acknowledged = api.send({"sequence": 1, "steps": steps})
    Acknowledgement.model_validate(acknowledged)
    told, other = ("rejected", "flagged") if gate else ("flagged", "rejected")
    assert acknowledged[other] == []
    landmark, robot = acknowledged[told]
    reason = "gate" if gate else "unlikely"
    assert (landmark["step"], landmark["observation"], landmark["landmark"], landmark["reason"]) == (1, 2, "a", reason)
    assert "robot" not in landmark
    assert (robot["step"], robot["observation"], robot["robot"], robot["reason"]) == (1, 2, "r2", reason)
    assert "landmark" not in robot
    assert robot["nis"] == pytest.approx(3.0**2 / (2 * 0.1**2))
    # Asked for again, it is told in the same words; and it is counted where it was not used.
    assert api.send({"sequence": 1, "steps": steps}) == {**acknowledged, "duplicate": True}
    for counts in (api.get("/robots/r1"), api.get("")["counts"]):
        assert (counts["rejected"], counts["observations"]) == ((2, 5) if gate else (0, 7))


def test_a_gate_keeps_outliers_from_the_estimate(make: Make) -> None:
    rng = np.random.default_rng(1)
    gated, ungated = (make({**ODOMETRY_MAP, "association": {"gate": gate}}) for gate in (0.999, None))
    steps: list[Json] = []
    wrong: list[int] = []
    for k in range(60):
        x, y = np.array([4.0, 1.0]) + rng.normal(size=2) * 0.1
        if k % 7 == 3:
            wrong.append(k)
            x, y = x + 3.0, y - 4.0
        steps.append({"t": float(k), "observations": [{"landmark": "a", "x": x, "y": y}]})
    acknowledged = gated.send({"sequence": 1, "steps": steps})
    assert {one["step"] for one in acknowledged["rejected"]} >= set(wrong)
    assert len(acknowledged["rejected"]) <= len(wrong) + 2
    assert all((one["reason"], one["nis"] > 13.8) == ("gate", True) for one in acknowledged["rejected"])
    assert gated.get("")["counts"]["rejected"] == len(acknowledged["rejected"])
    assert gated.get("/robots/r1")["rejected"] == len(acknowledged["rejected"])
    ungated.send({"sequence": 1, "steps": steps})
    assert ungated.get("")["counts"]["rejected"] == 0
    errors = [math.hypot(one["x"] - 4.0, one["y"] - 1.0) for one in (a.get("/landmarks/a") for a in (gated, ungated))]
    assert errors[0] < 4 * 0.1 / math.sqrt(50)
    assert errors[1] > 0.3
