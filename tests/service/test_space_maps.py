"""Maps in space over HTTP: what comes in, comes out as positions, quaternions and 6x6 covariances that agree."""

from __future__ import annotations

import uuid
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from service.wire.answers import (
    Graph,
    LandmarkAnswer,
    LandmarkList,
    PoseAnswer,
    RobotAnswer,
    RobotList,
    SpatialPoseAnswer,
    SubmapDetail,
    SubmapList,
    Trajectory,
    TransformAnswer,
)
from service.wire.base import Wire
from service.wire.maps import MapAnswer
from service.wire.measurements import Acknowledgement
from service.wire.poses import pose_answer, pose_of
from service.wire.robots import SpatialRobotSettingsAnswer
from submaps.alignment import align
from submaps.consistency import chi_square_bound
from submaps.geometry.space import SOLID
from tests.service.space import (
    CONTROL,
    NO_MOTION,
    PINHOLE,
    POINTS,
    SPACE,
    STEREO,
    batches,
    is_unit,
    landmarks,
    pose_at,
    space_map,
    truth,
)
from tests.service.support import COLUMNS_TYPE, Api, Json, Server, problem, serving

Floats = NDArray[np.float64]
STEPS = 150


def made(server: Server, config: Json) -> Api:
    return Api(server.url, f"m{uuid.uuid4().hex[:12]}").make(config)


def drive(api: Api, observation: Json, **options: Any) -> list[Json]:
    """Send 150 steps, solve, and return the acknowledgements."""
    acknowledged = [api.send(batch) for batch in batches(5, STEPS // 5, observation, **options)]
    for one in acknowledged:
        Acknowledgement.model_validate(one)
    api.optimize()
    return acknowledged


@pytest.fixture(scope="module")
def driven(server: Server) -> Iterator[Api]:
    """Two and a half laps with odometry and points, in several sub-maps, solved."""
    with closing(made(server, SPACE)) as api:
        drive(api, POINTS)
        yield api


@pytest.fixture(scope="module")
def motionless(server: Server) -> Iterator[Api]:
    """The same way, of which nothing is measured but what is seen by a pair of cameras."""
    with closing(made(server, space_map(STEREO, NO_MOTION, max_landmarks=60))) as api:
        drive(api, STEREO, odometry=False)
        yield api


def positions(found: list[Json]) -> Floats:
    return np.array([[one["x"], one["y"], one["z"]] for one in found])


def in_first_frame(names: list[str]) -> Floats:
    """Where landmarks truly lie, in the frame of the first pose."""
    return SOLID.transform(SOLID.inverse(pose_at(0)), landmarks()[[int(name) for name in names]])


@pytest.mark.parametrize(("path", "model"), [
    ("", MapAnswer),
    ("/robots", RobotList),
    ("/robots/r1", RobotAnswer),
    ("/robots/r1/pose", SpatialPoseAnswer),
    ("/robots/r1/pose?frame=odom", SpatialPoseAnswer),
    ("/robots/r1/pose?frame=submap/0", SpatialPoseAnswer),
    ("/robots/r1/trajectory", Trajectory),
    ("/landmarks", LandmarkList),
    ("/landmarks/0", LandmarkAnswer),
    ("/submaps", SubmapList),
    ("/submaps/0", SubmapDetail),
    ("/graph", Graph),
    ("/graph/transform?from=0&to=1", TransformAnswer),
])  # fmt: skip
def test_answers_have_the_form_that_is_documented(driven: Api, path: str, model: type[Wire]) -> None:
    answer = driven.http.get(driven.root + path)
    assert answer.status_code == 200, answer.text
    model.model_validate_json(answer.content)


def test_forms_of_the_plane_and_of_space_are_told_apart(driven: Api) -> None:
    answer = driven.get("/robots/r1/pose")
    with pytest.raises(ValueError, match="theta"):
        PoseAnswer.model_validate(answer)
    assert np.shape(answer["covariance"]) == (6, 6)
    assert is_unit(answer["quaternion"])
    assert np.shape(driven.get("/landmarks")["landmarks"][0]["covariance"]) == (3, 3)
    assert driven.get("")["config"]["space"] == "se3"


def test_the_trajectory_is_where_the_robot_flew(driven: Api) -> None:
    track = driven.get("/robots/r1/trajectory")["poses"]
    assert [round(10 * pose["t"]) for pose in track] == list(range(1, STEPS + 1))
    assert all(is_unit(pose["quaternion"]) for pose in track)
    true = truth(STEPS)
    assert np.sqrt(np.mean(np.sum((positions(track) - np.array(true)[:, :3]) ** 2, axis=1))) < 0.3
    turns = [SOLID.between(pose_of(pose), there)[3:] for pose, there in zip(track, true, strict=True)]
    assert np.linalg.norm(turns, axis=1).max() < 0.1


def test_the_pose_and_the_landmarks_lie_within_their_covariances(driven: Api) -> None:
    """R = exp(e) R of the estimate: the rotation's error is about the frame's axes."""
    answer = driven.get("/robots/r1/pose")
    pose, true = pose_of(answer), truth(STEPS)[-1]
    e_rotation = SOLID.compose((0.0, 0.0, 0.0, *true[3:]), SOLID.inverse((0.0, 0.0, 0.0, *pose[3:])))[3:]
    error = np.array([*np.subtract(true[:3], pose[:3]), *e_rotation])
    assert error @ np.linalg.solve(answer["covariance"], error) < chi_square_bound(0.9999, 6)
    found = driven.all_of("landmarks")
    off = positions(found) - in_first_frame([one["id"] for one in found])
    squares = [float(e @ np.linalg.solve(one["covariance"], e)) for e, one in zip(off, found, strict=True)]
    assert len(found) == 40
    assert max(squares) < chi_square_bound(1.0 - 1e-4 / 40, 3)


def test_frames_close_the_loop(driven: Api) -> None:
    in_map, in_odom = (driven.get("/robots/r1/pose", frame=frame) for frame in ("map", "odom"))
    closed = SOLID.compose(pose_of(in_map["map_T_odom"]), pose_of(in_odom))
    np.testing.assert_allclose(closed, pose_of(in_map), atol=1e-9)
    assert (in_map["covariance_kind"], in_odom["covariance_kind"]) == ("joined", "dead_reckoning")
    assert np.linalg.eigvalsh(in_map["covariance"]).min() > 0.0
    last = driven.get("/robots/r1/trajectory", frame="odom")["poses"][-1]
    np.testing.assert_allclose(pose_of(last), pose_of(in_odom), atol=1e-12)


def test_the_acknowledged_pose_is_that_in_the_active_sub_map(server: Server) -> None:
    with closing(made(server, SPACE)) as api:
        for batch in batches(3, 10, POINTS):
            said = api.send(batch)["pose"]
            local = api.get("/robots/r1/pose", frame=said["frame"])
            assert local["covariance_kind"] == "filtered"
            assert "map_T_odom" not in local
            np.testing.assert_allclose(pose_of(said), pose_of(local), atol=1e-12)
            del said["t"]
            assert api.get("/robots/r1")["pose"] == said


def test_tum_lines_hold_the_whole_pose(driven: Api) -> None:
    track = driven.get("/robots/r1/trajectory")["poses"]
    answer = driven.http.get(f"{driven.root}/robots/r1/trajectory", params={"format": "tum"})
    rows = np.loadtxt(answer.text.splitlines())
    np.testing.assert_array_equal(rows, [[p["t"], p["x"], p["y"], p["z"], *p["quaternion"]] for p in track])


def test_landmarks_within_a_box_of_x_and_y(driven: Api) -> None:
    whole = driven.all_of("landmarks")
    box = (-3.0, 0.0, 6.0, 9.0)
    inside = [one["id"] for one in whole if box[0] <= one["x"] <= box[2] and box[1] <= one["y"] <= box[3]]
    assert [one["id"] for one in driven.all_of("landmarks", bbox=",".join(map(str, box)), limit=3)] == inside
    assert 0 < len(inside) < len(whole)


def test_sub_maps_and_their_graph(driven: Api) -> None:
    whole = driven.all_of("submaps")
    assert len(whole) > 2
    assert sum(one["steps"] for one in whole) == STEPS
    detail = driven.get("/submaps/1")
    assert np.shape(detail["covariance"]) == np.shape(detail["robot_pose"]["covariance"]) == (6, 6)
    assert len(detail["local_landmarks"]) == detail["landmarks"]
    # Where it ends, the next one begins.
    end = SOLID.compose(pose_of(detail["pose"]), pose_of(detail["robot_pose"]))
    assert np.linalg.norm(np.subtract(end[:3], pose_of(whole[2]["pose"])[:3])) < 0.2
    kinds = {edge["kind"] for edge in driven.get("/graph")["edges"]}
    assert kinds == {"exit", "tie"}
    there, back = (driven.get("/graph/transform", **{"from": a, "to": b}) for a, b in ((0, 2), (2, 0)))
    around = SOLID.compose(pose_of(there["transform"]), pose_of(back["transform"]))
    np.testing.assert_allclose(around, np.zeros(6), atol=1e-9)
    assert np.shape(there["covariance"]) == (6, 6)


@pytest.mark.parametrize("observation", [STEREO, PINHOLE])
def test_cameras_map_their_landmarks(server: Server, observation: Json) -> None:
    with closing(made(server, space_map(observation))) as api:
        drive(api, observation)
        found = api.all_of("landmarks")
        off = positions(found) - in_first_frame([one["id"] for one in found])
        assert len(found) > 20
        assert np.median(np.linalg.norm(off, axis=1)) < 0.3
        true = truth(STEPS)[-1]
        assert np.linalg.norm(np.subtract(pose_of(api.get("/robots/r1/pose"))[:3], true[:3])) < 0.5


# -- without motion ------------------------------------------------------------------------------


def test_without_motion_poses_follow_from_what_is_seen(motionless: Api) -> None:
    # The first pose that is known is that of the first step.
    track, true = motionless.get("/robots/r1/trajectory")["poses"], truth(STEPS, origin=1)
    assert len(track) == STEPS
    off = np.linalg.norm(positions(track) - np.array(true)[:, :3], axis=1)
    assert np.median(off) < 0.3
    found = motionless.all_of("landmarks")
    assert align(positions(found), in_first_frame([one["id"] for one in found])).rmse < 0.2


def test_without_motion_there_is_no_dead_reckoning(motionless: Api) -> None:
    answer = motionless.get("/robots/r1/pose")
    assert "map_T_odom" not in answer
    assert answer["covariance_kind"] == "joined"
    for path in ("pose", "trajectory"):
        refused = problem(motionless.http.get(f"{motionless.root}/robots/r1/{path}?frame=odom"), 409)
        assert refused["type"] == "not-connected"
        assert "no motion model" in refused["detail"]
    problem(motionless.http.get(f"{motionless.root}/robots/r9/pose?frame=odom"), 404)


def test_without_motion_a_control_is_refused(motionless: Api) -> None:
    before = motionless.get("")
    rows: Json = {"sequence": 6, "steps": [{"t": 99.0, "odometry": dict.fromkeys(CONTROL, 0.0)}]}
    fault = problem(motionless.post(rows), 422)["errors"][0]
    assert fault["path"] == "steps.0.odometry"
    assert "motion model is none" in fault["message"]
    columns = {"sequence": 6, "t": [99.0], "control": [[0.0]] * 6}
    assert problem(motionless.post(columns, type_=COLUMNS_TYPE), 422)["errors"][0]["path"] == "control"
    assert motionless.get("") == before


def test_a_pose_that_too_little_is_seen_for_is_lost(server: Server) -> None:
    with closing(made(server, space_map(POINTS, NO_MOTION))) as api:
        seen = [{"landmark": str(i), "x": float(i), "y": float(i * i), "z": 1.0} for i in range(4)]
        steps = [{"t": float(k), "observations": seen[:shown]} for k, shown in enumerate((4, 2, 4))]
        rejected = api.send({"sequence": 1, "steps": steps})["rejected"]
        told = [(one["step"], one["landmark"], one["reason"]) for one in rejected]
        assert told == [(1, "0", "lost"), (1, "1", "lost")]


# -- what is refused, what is set aside ----------------------------------------------------------


def test_a_point_that_is_not_ahead_begins_no_landmark(server: Server) -> None:
    with closing(made(server, space_map(STEREO))) as api:
        ahead = {"u_left": 340.0, "v_left": 250.0, "u_right": 320.0, "v_right": 250.0}
        seen = [{"landmark": "a", **ahead}, {"landmark": "b", **ahead, "u_right": 340.0}]
        acknowledged = api.send({"sequence": 1, "steps": [{"t": 1.0, "observations": seen}]})
        (rejected,) = acknowledged["rejected"]
        assert (rejected["landmark"], rejected["reason"], rejected["nis"]) == ("b", "singular", None)
        (one,) = api.all_of("landmarks")
        # 20 px of 400 and 0.3 m: 6 m ahead of a camera that lies 0.1 m before and 0.2 m above the body.
        np.testing.assert_allclose([one[name] for name in "xyz"], [6.1, -0.3, 0.2 - 6.0 * 10.0 / 410.0], atol=1e-9)


def test_robots_that_see_one_another_are_of_the_plane(server: Server) -> None:
    with closing(made(server, SPACE)) as api:
        body = {"sequence": 1, "steps": [{"t": 1.0, "encounters": [{"robot": "r2", "x": 1.0, "y": 2.0, "z": 0.0}]}]}
        fault = problem(api.post(body), 422)["errors"][0]
        assert fault["path"] == "steps.0.encounters"
        assert "se2" in fault["message"]
        assert api.get("")["counts"]["robots"] == 0


# -- robots --------------------------------------------------------------------------------------

START = SOLID.compose(SOLID.inverse(pose_at(0)), pose_at(20))
SPREAD = np.diag([0.01, 0.01, 0.01, 1e-4, 1e-4, 1e-4])


def test_a_robot_starts_where_its_operator_says(server: Server) -> None:
    with closing(made(server, SPACE)) as api:
        api.send(batches(1, 20, POINTS)[0])
        start = {"frame": "map", **pose_answer(START), "covariance": SPREAD.tolist()}
        answer = api.http.put(f"{api.root}/robots/r2", json={"start": start, "observation": STEREO})
        assert answer.status_code == 200, answer.text
        SpatialRobotSettingsAnswer.model_validate_json(answer.content)
        assert answer.json()["start"]["covariance"] == SPREAD.tolist()
        api.send({"sequence": 1, "steps": [{"t": 2.0}]}, "r2")
        found = api.get("/robots/r2/pose")
        np.testing.assert_allclose(pose_of(found), START, atol=1e-9)
        # A pose without variance of its own is given (1e-4 m)².
        np.testing.assert_allclose(found["covariance"], SPREAD, atol=2e-8)
        refused = api.http.put(f"{api.root}/robots/r3", json={"motion": {"model": "velocity", "sigma": [1, 1]}})
        assert problem(refused, 422)["errors"][0]["path"] == "motion.model"


def test_two_robots_meet_by_what_they_share(server: Server) -> None:
    with closing(made(server, SPACE)) as api:
        first, *rest = batches(3, 20, POINTS, seed=1)
        api.send(first)
        for sequence, batch in enumerate(rest, start=1):
            api.send({**batch, "sequence": sequence}, "r2")
        api.send(rest[0], "r1")
        api.optimize()
        assert [one["connected"] for one in api.all_of("robots")] == [True, True]
        found = api.get("/robots/r2/pose")
        assert np.linalg.norm(np.subtract(pose_of(found)[:3], truth(60)[-1][:3])) < 0.5


def test_a_restart_remembers_maps_in_space(tmp_path: Path) -> None:
    with serving(tmp_path) as server:
        with closing(Api(server.url, "room").make(SPACE)) as api, closing(Api(server.url, "dark")) as dark:
            start = {"frame": "map", **pose_answer(START), "covariance": SPREAD.tolist()}
            assert api.http.put(f"{api.root}/robots/r1", json={"start": start}).status_code == 200
            drive(api, POINTS)
            dark.make(space_map(STEREO, NO_MOTION, max_landmarks=60))
            dark.send(batches(1, 30, STEREO, odometry=False)[0])
            before = everything(api), dark.get("/robots/r1/pose"), dark.all_of("landmarks")
        server.kill()
    with serving(tmp_path) as server, closing(Api(server.url, "room")) as api, closing(Api(server.url, "dark")) as dark:
        assert (everything(api), dark.get("/robots/r1/pose"), dark.all_of("landmarks")) == before
        assert api.send(batches(5, STEPS // 5, POINTS)[4])["duplicate"] is True


def everything(api: Api) -> Json:
    """All about a map, once no solve is on its way."""
    found = api.everything()
    while (again := api.everything()) != found:
        found = again
    return found
