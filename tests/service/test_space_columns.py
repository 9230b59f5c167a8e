"""Measurements of maps in space, and bearings in the plane: rows and columns are one batch, faults are named."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from service.problems import Problem
from service.store.encoding import decode_batch, encode_batch
from service.wire.columns import COLUMNS_TYPE, ROWS_TYPE, Decoded, decode
from tests.service.space import (
    BEARING_MAP,
    CHANNELS,
    CONTROL,
    MOTION,
    NO_MOTION,
    PINHOLE,
    POINTS,
    SPACE,
    STEREO,
    as_columns,
    core_of,
    space_map,
    steps,
    without,
)
from tests.service.support import Json


def read(type_: str, body: Json, config: Json) -> Decoded:
    return decode(type_, json.dumps(body).encode(), core_of(config), "r1")


def refused(type_: str, body: Json, config: Json) -> tuple[str, str]:
    with pytest.raises(Problem) as caught:
        read(type_, body, config)
    assert caught.value.status == 422
    return caught.value.errors[0]


@pytest.mark.parametrize("observation", [POINTS, STEREO, PINHOLE])
@pytest.mark.parametrize("motion", [MOTION, NO_MOTION])
def test_rows_and_columns_are_one_batch_and_the_journal_keeps_it(observation: Json, motion: Json) -> None:
    if motion is NO_MOTION and observation is PINHOLE:
        return
    config, moves = space_map(observation, motion), motion is MOTION
    rows: Json = {"sequence": 3, "steps": steps(12, observation, odometry=moves)}
    one, other = read(ROWS_TYPE, rows, config), read(COLUMNS_TYPE, as_columns(rows, observation), config)
    assert (one.sequence, other.sequence) == (3, 3)
    batch = one.batch
    assert encode_batch(batch) == encode_batch(other.batch)
    assert batch.observations > 12
    assert batch.z.shape == (len(CHANNELS[observation["model"]]), batch.observations)
    assert batch.control.shape == ((6, 12) if moves else (0, 0))
    again = decode_batch(encode_batch(batch))
    assert (again.z.shape, again.control.shape) == (batch.z.shape, batch.control.shape)
    assert encode_batch(again) == encode_batch(batch)
    row = rows["steps"][4]["observations"][0]
    at = int(np.searchsorted(batch.observation_step, 4))
    assert batch.z[:, at].tolist() == [row[name] for name in CHANNELS[observation["model"]]]
    if moves:
        assert batch.control[:, 7].tolist() == [rows["steps"][7]["odometry"][name] for name in CONTROL]


def test_covariances_of_their_own_in_space() -> None:
    own6, own3 = (np.diag(np.arange(1.0, n + 1)) + 0.1 for n in (6, 3))
    made = steps(3, POINTS)
    made[1]["odometry"]["covariance"] = own6.tolist()
    made[2]["observations"][0]["covariance"] = own3.tolist()
    batch = read(ROWS_TYPE, {"sequence": 1, "steps": made}, SPACE).batch
    assert batch.control_covariance is not None
    assert batch.observation_covariance is not None
    np.testing.assert_array_equal(batch.control_covariance[1], own6)
    np.testing.assert_array_equal(batch.control_covariance[0], np.diag(np.square(MOTION["sigma"])))
    at = int(np.searchsorted(batch.observation_step, 2))
    np.testing.assert_array_equal(batch.observation_covariance[at], own3)
    np.testing.assert_array_equal(batch.observation_covariance[0], np.diag(np.square(POINTS["sigma"])))
    columns = as_columns({"sequence": 1, "steps": made}, POINTS)
    columns["control_covariance"] = batch.control_covariance.tolist()
    columns["observation"]["covariance"] = batch.observation_covariance.tolist()
    assert encode_batch(read(COLUMNS_TYPE, columns, SPACE).batch) == encode_batch(batch)


def test_a_density_leaves_the_rest_to_the_model() -> None:
    made = steps(2, POINTS)
    made[1]["odometry"]["covariance"] = np.eye(6).tolist()
    body = {"sequence": 1, "steps": made}
    covariance = read(ROWS_TYPE, body, space_map(POINTS, MOTION | {"noise": "density"})).batch.control_covariance
    assert covariance is not None
    assert np.isnan(covariance[0, 0, 0])
    np.testing.assert_array_equal(covariance[1], np.eye(6))


def test_bearings_become_columns() -> None:
    body = {"sequence": 1, "steps": [
        {"t": 1.0, "observations": [{"landmark": "a", "bearing": 0.5}, {"landmark": "b", "bearing": -2}]},
        {"t": 2.0, "odometry": {"dx": 1, "dy": 0, "dtheta": 0},
         "observations": [{"landmark": "a", "bearing": 0.6, "covariance": [[0.01]]}],
         "encounters": [{"robot": "r2", "bearing": 1.0}]},
    ]}  # fmt: skip
    batch = read(ROWS_TYPE, body, BEARING_MAP).batch
    assert batch.z.tolist() == [[0.5, -2.0, 0.6, 1.0]]
    assert batch.observation_covariance is not None
    np.testing.assert_allclose(batch.observation_covariance[:, 0, 0], [4e-4, 4e-4, 0.01, 4e-4])
    columns = {
        "sequence": 1, "t": [1.0, 2.0], "control": [[1], [0], [0]], "control_step": [1],
        "observation": {"step": [0, 0, 1], "landmark": ["a", "b", "a"], "z": [[0.5, -2, 0.6]],
                        "covariance": batch.observation_covariance[:3].tolist()},
        "encounter": {"step": [1], "robot": ["r2"], "z": [[1.0]]},
    }  # fmt: skip
    assert encode_batch(read(COLUMNS_TYPE, columns, BEARING_MAP).batch) == encode_batch(batch)


def rows_with(**fields: Any) -> Json:
    return {"sequence": 1, "steps": [{"t": 1.0, **fields}]}


STILL = dict.fromkeys(CONTROL, 0.0)
POINT = {"landmark": "a", "x": 1.0, "y": 2.0, "z": 3.0}
SEEN = {"step": [0], "landmark": ["a"], "z": [[1.0], [2.0], [3.0]]}
MOTIONLESS = space_map(POINTS, NO_MOTION)
BAD_ROWS: dict[str, tuple[Json, Json, str, str]] = {
    "an odometry of the plane": (SPACE, rows_with(odometry={"dx": 1.0, "dy": 0.0, "dtheta": 0.0}),
                                 "steps.0.odometry.dz", "odometry3d (dx, dy, dz, rx, ry, rz)"),
    "a velocity": (SPACE, rows_with(velocity={"v": 1.0, "omega": 0.0}), "steps.0.velocity", "odometry3d"),
    "an absurd turn": (SPACE, rows_with(odometry=STILL | {"rx": 1e6}), "steps.0.odometry.rx", "100000"),
    "a covariance of 3x3": (SPACE, rows_with(odometry=STILL | {"covariance": np.eye(3).tolist()}),
                            "steps.0.odometry.covariance", "6 lists of 6"),
    "a point of the plane": (SPACE, rows_with(observations=[without(POINT, "z")]),
                             "steps.0.observations.0.z", "cartesian3d (x, y, z)"),
    "a point's covariance of 2x2": (SPACE, rows_with(observations=[POINT | {"covariance": np.eye(2).tolist()}]),
                                    "steps.0.observations.0.covariance", "3 lists of 3"),
    "pixels where points are seen": (SPACE, rows_with(observations=[{"landmark": "a", "u": 1.0, "v": 2.0}]),
                                     "steps.0.observations.0.x", "cartesian3d"),
    "one picture of two": (space_map(STEREO), rows_with(observations=[{"landmark": "a", "u_left": 1.0, "v_left": 2.0}]),
                           "steps.0.observations.0.u_right", "stereo (u_left, v_left, u_right, v_right)"),
    "pixels without end": (space_map(PINHOLE), rows_with(observations=[{"landmark": "a", "u": float("inf"), "v": 2.0}]),
                           "steps.0.observations.0.u", "finite"),
    "encounters": (SPACE, rows_with(encounters=[{"robot": "r2", "x": 1.0, "y": 2.0}]),
                   "steps.0.encounters", "robots that see one another are of maps in se2"),
    "a control without motion": (MOTIONLESS, rows_with(odometry=STILL), "steps.0.odometry",
                                 "does not fit; this robot's motion model is none and its observations are"),
    "a range in a map of bearings": (BEARING_MAP, rows_with(observations=[{"landmark": "a", "range": 1, "bearing": 1}]),
                                     "steps.0.observations.0.range", "unknown field"),
    "an absurd bearing": (BEARING_MAP, rows_with(observations=[{"landmark": "a", "bearing": -1e6}]),
                          "steps.0.observations.0.bearing", "100000"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD_ROWS)
def test_bad_rows(name: str) -> None:
    config, body, path, message = BAD_ROWS[name]
    where, what = refused(ROWS_TYPE, body, config)
    assert (where, message in what) == (path, True), what


def columns_with(**fields: Any) -> Json:
    return {"sequence": 1, "t": [1.0], **fields}


BAD_COLUMNS: dict[str, tuple[Json, Json, str, str]] = {
    "controls of three": (SPACE, columns_with(control=[[0.0]] * 3), "control", "expected 6: dx, dy, dz, rx, ry, rz"),
    "an absurd turn": (SPACE, columns_with(control=[[0.0]] * 5 + [[-1e6]]), "control.5.0", "within 100000 rad"),
    "controls without motion": (MOTIONLESS, columns_with(control=[[0.0]] * 6), "control", "motion model is none"),
    "a covariance of 3x3": (SPACE, columns_with(control=[[0.0]] * 6, control_covariance=[np.eye(3).tolist()]),
                            "control_covariance.0", "6 lists of 6"),
    "points of the plane": (SPACE, columns_with(observation=SEEN | {"z": [[1.0], [2.0]]}),
                            "observation.z", "expected 3: x, y, z"),
    "points' covariance of 2x2": (SPACE, columns_with(observation=SEEN | {"covariance": [np.eye(2).tolist()]}),
                                  "observation.covariance.0", "3 lists of 3"),
    "encounters": (SPACE, columns_with(encounter={"step": [0], "robot": ["r2"], "z": [[1.0], [2.0], [3.0]]}),
                   "encounter", "robots that see one another are of maps in se2"),
    "an absurd bearing": (BEARING_MAP, columns_with(observation=SEEN | {"z": [[1e6]]}), "observation.z.0.0", "100000"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD_COLUMNS)
def test_bad_columns(name: str) -> None:
    config, body, path, message = BAD_COLUMNS[name]
    where, what = refused(COLUMNS_TYPE, body, config)
    assert (where, message in what) == (path, True), what
