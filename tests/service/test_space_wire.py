"""What a map in space is made of and what is sent to it, as read and written; bearings in the plane."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.client import settings
from service.problems import Problem
from service.wire.base import parse
from service.wire.maps import CONFIG, MAP_REQUEST
from service.wire.poses import point_answer, point_of, pose_answer, pose_of, tum_rest, unit_quaternion
from service.wire.robots import ROBOT_REQUESTS, ROBOTS, start_hint
from submaps.config import Camera, Depth, MotionConfig, ObservationConfig
from submaps.geometry.space import SOLID
from tests.service.space import (
    BEARING_MAP,
    MOTION,
    NO_MOTION,
    PINHOLE,
    POINTS,
    SPACE,
    STEREO,
    core_of,
    is_unit,
    space_map,
    without,
)
from tests.service.support import ODOMETRY_MAP, Json


def told_of(body: Json) -> Json:
    """What a map is made of, as its answers say it."""
    told: Json = json.loads(parse(MAP_REQUEST, json.dumps(body).encode()).config().model_dump_json())
    return told


# -- poses ---------------------------------------------------------------------------------------

numbers = st.floats(-10.0, 10.0)


@given(st.lists(numbers, min_size=3, max_size=3), st.lists(st.floats(-1.7, 1.7), min_size=3, max_size=3))
def test_poses_come_back(position: list[float], turn: list[float]) -> None:
    pose = (*position, *turn)  # no longer than pi
    told = pose_answer(pose)
    assert list(told) == ["x", "y", "z", "quaternion"]
    assert is_unit(list(told["quaternion"]))
    np.testing.assert_allclose(pose_of(told), pose, atol=1e-12)
    assert pose_of(pose_answer((1.5, -2.0, 0.3))) == (1.5, -2.0, 0.3)
    line = [float(word) for word in tum_rest(pose).split()]
    assert line == [*position, *told["quaternion"]]


def test_a_quaternion_turns_as_the_rotation_matrix_of_its_pose() -> None:
    """A quarter turn to the left about z, then what was x points along y: (0, 0, sin 45°, cos 45°)."""
    told = pose_answer((0.0, 0.0, 0.0, 0.0, 0.0, np.pi / 2))
    np.testing.assert_allclose(told["quaternion"], [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)], atol=1e-15)
    np.testing.assert_allclose(SOLID.rotation(pose_of(told)) @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-15)


@pytest.mark.parametrize("point", [[1.0, 2.0], [1.0, 2.0, 3.0]])
def test_points_come_back(point: list[float]) -> None:
    assert list(point_of(point_answer(np.array(point)))) == point


def test_a_quaternion_may_be_rounded_but_has_to_be_one() -> None:
    assert unit_quaternion("q", [0.0, 0.0, 0.7071, 0.7071])[3] == pytest.approx(np.sqrt(0.5), abs=1e-15)
    for given_ in ([0.0] * 4, [0.0, 0.0, 0.0, 1.01], [1.0, 0.0, 0.0]):
        with pytest.raises(Problem, match="unit quaternion"):
            unit_quaternion("q", given_)


# -- maps ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("motion", [MOTION, MOTION | {"noise": "density"}, NO_MOTION])
@pytest.mark.parametrize("observation", [POINTS, STEREO, PINHOLE])
def test_a_map_in_space_reaches_the_estimator_and_comes_back(observation: Json, motion: Json) -> None:
    body = space_map(observation, motion)
    if motion is NO_MOTION and observation is PINHOLE:
        with pytest.raises(Problem, match=r"observation\.model: got 'pinhole', expected one of cartesian3d, stereo"):
            core_of(body)
        return
    told = told_of(body)
    for name in ("space", "motion", "observation"):
        assert told[name] == body[name]
    core = parse(CONFIG, json.dumps(told).encode()).to_core()
    assert core == core_of(body)
    assert core.space == "se3"
    assert core.motion.model == motion["model"]
    # The client says the same again.
    assert core_of(json.loads(json.dumps(settings(core)))) == core


def test_mounts_cameras_and_depths_as_the_estimator_has_them() -> None:
    core = core_of(space_map(PINHOLE)).observation
    assert core.mount == tuple(PINHOLE["mount"])
    assert core.camera == Camera(400.0, 410.0, 320.0, 240.0)
    assert core.depth == Depth(4.0, 1.5)
    assert core_of(BEARING_MAP).observation == ObservationConfig("bearing", (0.02,), depth=Depth(8.0, 4.0))
    assert core_of(space_map(STEREO, NO_MOTION)).motion == MotionConfig("none", ())


def test_a_mount_that_is_left_out_is_the_bodys_and_is_told() -> None:
    for config, mount in ((space_map({**POINTS}), [0.0] * 6 + [1.0]), (BEARING_MAP, [0.0] * 3)):
        observation = {name: value for name, value in config["observation"].items() if name != "mount"}
        told = json.loads(
            parse(MAP_REQUEST, json.dumps(config | {"observation": observation}).encode()).model_dump_json()
        )
        assert told["observation"]["mount"] == mount
        assert "camera" not in told["observation"]


def test_a_map_of_the_plane_is_told_as_it_was_before_there_was_space() -> None:
    told = json.loads(
        parse(MAP_REQUEST, json.dumps(ODOMETRY_MAP | {"space": "se2"}).encode()).config().model_dump_json()
    )
    assert list(told) == ["motion", "observation", "filter", "association", "submap"]
    assert list(told["observation"]) == ["model", "sigma", "mount"]


BAD_MAPS: dict[str, tuple[Json, str, str]] = {
    "an unknown space": (SPACE | {"space": "se4"}, "space", "'se2' or 'se3'"),
    "a motion of the plane": (SPACE | {"motion": ODOMETRY_MAP["motion"]}, "motion.model", "odometry3d, none in se3"),
    "a motion of space in the plane": (ODOMETRY_MAP | {"motion": MOTION}, "motion.model", "ackermann in se2"),
    "no motion in the plane": (ODOMETRY_MAP | {"motion": NO_MOTION}, "motion.model", "in se2"),
    "an observation of the plane": (SPACE | {"observation": ODOMETRY_MAP["observation"]}, "observation.model", "se3"),
    "an observation of space in the plane": (without(SPACE, "space", "motion") | {"motion": ODOMETRY_MAP["motion"]},
                                             "observation.model", "cartesian, range_bearing, bearing in se2"),
    "one camera without motion": (space_map(PINHOLE, NO_MOTION), "observation.model", "without a motion model"),
    "no motion with a sigma": (space_map(POINTS, {"model": "none", "sigma": []}), "motion.none.sigma", "unknown"),
    "a motion's sigma of three": (space_map(POINTS, MOTION | {"sigma": [0.1] * 3}), "motion.odometry3d.sigma", "6"),
    "an observation's sigma of two": (space_map(POINTS | {"sigma": [0.1] * 2}), "observation.sigma", "3 finite"),
    "a planar mount": (space_map(POINTS | {"mount": [0.0] * 3}), "observation.mount", "7 finite numbers"),
    "no mount at all": (space_map(POINTS | {"mount": []}), "observation.mount", "a pose"),
    "a mount whose quaternion is none": (space_map(POINTS | {"mount": [0.0] * 7}), "observation.mount", "unit quat"),
    "no camera": (space_map(without(STEREO, "camera")), "observation.camera", "fu, fv, cu, cv for stereo"),
    "a camera in part": (space_map(STEREO | {"camera": {"fu": 1.0}}), "observation.camera.fv", "required"),
    "a camera of no length": (space_map(STEREO | {"camera": STEREO["camera"] | {"fu": 0}}),
                              "observation.camera.fu", "greater"),
    "a pair without a baseline": (space_map(STEREO | {"camera": PINHOLE["camera"]}),
                                  "observation.camera.baseline", "above 0, for stereo"),
    "one camera with a baseline": (space_map(PINHOLE | {"camera": STEREO["camera"]}),
                                   "observation.camera.baseline", "none for pinhole"),
    "a camera that sees points": (space_map(POINTS | {"camera": PINHOLE["camera"]}), "observation.camera", "none"),
    "one camera without a depth": (space_map(without(PINHOLE, "depth")), "observation.depth", "for pinhole"),
    "a depth of 0": (space_map(PINHOLE | {"depth": {"mean": 0, "sigma": 1}}), "observation.depth.mean", "greater"),
    "a pair with a depth": (space_map(STEREO | {"depth": PINHOLE["depth"]}), "observation.depth", "none, as stereo"),
    "a bearing without a depth": (BEARING_MAP | {"observation": without(BEARING_MAP["observation"], "depth")},
                                  "observation.depth", "for bearing"),
    "a bearing of two": (BEARING_MAP | {"observation": BEARING_MAP["observation"] | {"sigma": [1, 1]}},
                         "observation.sigma", "1 finite"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD_MAPS)
def test_bad_maps(name: str) -> None:
    body, path, message = BAD_MAPS[name]
    with pytest.raises(Problem) as caught:
        core_of(body)
    assert caught.value.status == 422
    where, what = caught.value.errors[0]
    assert (where, message in what) == (path, True), what
    assert "got" in what or "required" in what or "unknown field" in what


# -- robots --------------------------------------------------------------------------------------

COVARIANCE = (np.diag([0.2, 0.2, 0.1, 0.01, 0.02, 0.03]) + 0.001).tolist()
THREE = np.eye(3).tolist()
START: Json = {
    "frame": "map",
    "x": 1.0,
    "y": 2.0,
    "z": 3.0,
    "quaternion": [0.0, 0.0, 0.6, 0.8],
    "covariance": COVARIANCE,
}


def own(body: Json, space: str = "se3") -> Any:
    defaults = parse(CONFIG, json.dumps(SPACE if space == "se3" else ODOMETRY_MAP).encode())
    return parse(ROBOT_REQUESTS[space], json.dumps(body).encode(), start_hint(space)).completed(defaults)


def test_a_start_in_space_is_kept_and_reaches_the_estimator() -> None:
    chosen = own({"start": START, "observation": STEREO})
    again = parse(ROBOTS["se3"], chosen.model_dump_json().encode())
    assert again == chosen
    core = again.to_core()
    assert core.motion.model == "odometry3d"
    assert core.observation.model == "stereo"
    assert core.start is not None
    assert core.start.pose[:3] == (1.0, 2.0, 3.0)
    np.testing.assert_allclose(core.start.pose[3:], [0.0, 0.0, 2.0 * np.arcsin(0.6)], atol=1e-15)
    np.testing.assert_array_equal(core.start.covariance, COVARIANCE)


BAD_STARTS: dict[str, tuple[str, Json, str, str]] = {
    "a start of the plane": ("se3", {"start": without(START, "z", "quaternion") | {"theta": 0.0}}, "start.z", "6x6"),
    "a start of space in the plane": ("se2", {"start": START}, "start.theta", "x, y, theta and a 3x3 covariance"),
    "a covariance of 3x3": ("se3", {"start": START | {"covariance": THREE}}, "start.covariance", "6 lists"),
    "a quaternion that is none":
        ("se3", {"start": START | {"quaternion": [1.0, 1.0, 0.0, 0.0]}}, "start.quaternion", "unit quaternion"),
    "a quaternion of three": ("se3", {"start": START | {"quaternion": [0.0, 0.0, 1.0]}}, "start.quaternion", "4"),
    "a motion of the plane": ("se3", {"motion": ODOMETRY_MAP["motion"]}, "motion.model", "in se3"),
    "an observation of the plane": ("se3", {"observation": ODOMETRY_MAP["observation"]}, "observation.model", "in se3"),
    "one camera without motion": ("se3", {"motion": NO_MOTION, "observation": PINHOLE}, "observation.model", "without"),
    "points of space in the plane": ("se2", {"observation": POINTS}, "observation.model", "in se2"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD_STARTS)
def test_bad_settings(name: str) -> None:
    space, body, path, message = BAD_STARTS[name]
    with pytest.raises(Problem) as caught:
        own(body, space).to_core()
    where, what = caught.value.errors[0]
    assert (where, message in what) == (path, True), what
