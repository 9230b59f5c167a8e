"""Whatever else is wrong with a request is named, and leaves the map as it was."""

from __future__ import annotations

import pytest

from tests.service.conftest import good
from tests.service.support import COLUMNS_TYPE, Api, Json, check, problem, steps


def test_unknown_things(unchanged: Api) -> None:
    http, root = unchanged.http, unchanged.root
    for path in (
        "/robots/r9",
        "/robots/r9/pose",
        "/robots/r9/trajectory",
        "/landmarks/none",
        "/submaps/99",
        "/solves/99",
        "/graph/transform?from=0&to=99",
        "/robots/r1/pose?frame=submap/99",
    ):
        problem(http.get(root + path), 404)
    problem(http.get("/v1/maps/none"), 404)
    problem(http.delete("/v1/maps/none"), 404)
    problem(http.get("/v2/maps"), 404)
    problem(http.post("/v1/maps/none/robots/r1/measurements", json=good()), 404)
    for name in ("Robot", "a b", "-a", "a" * 65):
        check(unchanged, unchanged.post({**good(), "sequence": 1}, robot=name), 422, "robot")


def test_wrong_methods(unchanged: Api) -> None:
    answer = unchanged.http.put(unchanged.root)
    problem(answer, 405)
    assert answer.headers["allow"] == "DELETE, GET"
    problem(unchanged.http.get(f"{unchanged.root}/optimize"), 405)
    problem(unchanged.http.delete(f"{unchanged.root}/robots/r1"), 405)


@pytest.mark.parametrize(("path", "field"), [
    ("/robots/r1/pose?frame=world", "frame"),
    ("/robots/r1/pose?frm=map", "frm"),
    ("/robots/r1/trajectory?kind=smoothed", "kind"),
    ("/robots/r1/trajectory?from=soon", "from"),
    ("/robots/r1/trajectory?format=csv", "format"),
    ("/landmarks?limit=0", "limit"),
    ("/landmarks?limit=1001", "limit"),
    ("/landmarks?cursor=nonsense", "cursor"),
    ("/landmarks?frame=odom", "frame"),
    ("/landmarks?bbox=1,2,3", "bbox"),
    ("/landmarks?bbox=3,0,1,1", "bbox"),
    ("/landmarks?bbox=0,0,nan,1", "bbox"),
    ("/submaps/first", "k"),
    ("/graph/transform?from=0", "to"),
])  # fmt: skip
def test_wrong_parameters(unchanged: Api, path: str, field: str) -> None:
    body = problem(unchanged.http.get(unchanged.root + path), 422)
    assert body["errors"][0]["path"] == field


def test_a_cursor_of_another_list(unchanged: Api) -> None:
    unchanged_cursor = unchanged.get("/landmarks", limit=1)["next"]
    assert unchanged_cursor
    answer = unchanged.http.get(f"{unchanged.root}/submaps", params={"cursor": unchanged_cursor})
    assert problem(answer, 422)["errors"][0]["path"] == "cursor"


def test_refinement_is_not_supported_yet(unchanged: Api) -> None:
    answer = unchanged.http.post(f"{unchanged.root}/optimize", json={"refine": True})
    assert problem(answer, 422)["errors"][0]["path"] == "refine"
    problem(unchanged.http.post(f"{unchanged.root}/optimize", json={"refined": True}), 422)
    problem(unchanged.http.post(f"{unchanged.root}/optimize?wait=perhaps"), 422)


MOTION = {"model": "odometry", "sigma": [0.1, 0.1, 0.1]}
OBSERVATION = {"model": "cartesian", "sigma": [0.1, 0.1]}
CAR = {"model": "ackermann", "sigma": [0.1, 0.02], "wheelbase": 2.83}
MAPS: dict[str, tuple[Json, str]] = {
    "no motion": ({"observation": OBSERVATION}, "motion"),
    "no observation": ({"motion": MOTION}, "observation"),
    "unknown motion": ({"motion": {**MOTION, "model": "tracks"}}, "motion"),
    "motion without a model": ({"motion": {"sigma": [1, 1, 1]}}, "motion"),
    "sigma short": ({"motion": {**MOTION, "sigma": [0.1, 0.1]}}, "motion.odometry.sigma"),
    "sigma below 0": ({"motion": {**MOTION, "sigma": [0.1, -0.1, 0.1]}}, "motion.odometry.sigma.1"),
    "unknown noise": ({"motion": {**MOTION, "noise": "per step"}}, "motion.odometry.noise"),
    "a wheelbase of no vehicle": ({"motion": {**MOTION, "wheelbase": 1.0}}, "motion.odometry.wheelbase"),
    "no wheelbase": ({"motion": {"model": "bicycle", "sigma": [0.1, 0.1]}}, "motion.bicycle.wheelbase"),
    "wheelbase 0": ({"motion": {**CAR, "wheelbase": 0}}, "motion.ackermann.wheelbase"),
    "a bicycle that slips":
        ({"motion": {"model": "bicycle", "sigma": [0.1, 0.1, 0.1], "wheelbase": 1.0}}, "motion.bicycle.sigma"),
    "a bicycle with an encoder":
        ({"motion": {**CAR, "model": "bicycle", "encoder_offset": 0.5}}, "motion.bicycle.encoder_offset"),
    "an encoder ahead of the car": ({"motion": {**CAR, "encoder_offset": 2.83}}, "motion.encoder_offset"),
    "unknown observation": ({"observation": {**OBSERVATION, "model": "radar"}}, "observation.model"),
    "sigma 0": ({"observation": {**OBSERVATION, "sigma": [0.1, 0]}}, "observation.sigma.1"),
    "mount short": ({"observation": {**OBSERVATION, "mount": [0, 0]}}, "observation.mount"),
    "unknown filter": ({"filter": "particle"}, "filter"),
    "unknown association": ({"association": {"method": "nearest"}}, "association.method"),
    "gate beyond 1": ({"association": {"gate": 9.21}}, "association.gate"),
    "no landmarks": ({"submap": {"max_landmarks": 0}}, "submap.max_landmarks"),
    "position 0": ({"submap": {"max_position_sigma": 0}}, "submap.max_position_sigma"),
    "heading 0": ({"submap": {"max_heading_sigma": 0}}, "submap.max_heading_sigma"),
    "unknown field": ({"color": "red"}, "color"),
    "bad id": ({"id": "Park!"}, "id"),
}  # fmt: skip


@pytest.mark.parametrize("name", MAPS)
def test_bad_maps(unchanged: Api, name: str) -> None:
    change, path = MAPS[name]
    body = {"motion": MOTION, "observation": OBSERVATION} | change
    if name in ("no motion", "no observation"):
        body = change
    found = problem(unchanged.http.post("/v1/maps", json=body), 422)
    assert found["errors"][0]["path"] == path


def test_an_id_that_is_taken(unchanged: Api) -> None:
    answer = unchanged.http.post("/v1/maps", json={"id": unchanged.id, "motion": MOTION, "observation": OBSERVATION})
    assert problem(answer, 409)["type"] == "map-exists"


def test_a_model_that_does_not_match(velocity_api: Api) -> None:
    check(velocity_api, velocity_api.post({"sequence": 1, "steps": steps(1)}), 422, None)
    polar = {"landmark": "1", "range": 0.0, "bearing": 0.1}
    check(
        velocity_api,
        velocity_api.post({"sequence": 1, "steps": [{"t": 1, "observations": [polar]}]}),
        422,
        "steps.0.observations.0.range",
    )
    columns = {"sequence": 1, "t": [1.0], "control": [[1.0], [0.1]], "control_covariance": [[[1, 0], [0, 1]]]}
    check(velocity_api, velocity_api.post(columns, type_=COLUMNS_TYPE), 422, "control_covariance.0")
    assert velocity_api.get("")["counts"]["steps"] == 0
