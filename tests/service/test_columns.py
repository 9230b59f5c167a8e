"""Rows and columns of equal content are one batch."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.store.encoding import digest, encode_batch
from service.wire.base import parse
from service.wire.columns import COLUMNS_TYPE, ROWS_TYPE, Decoded, decode
from service.wire.maps import MAP_REQUEST
from submaps.config import MotionConfig
from submaps.measurements import as_encounter, encounter
from submaps.motion.increments import increments
from tests.service.support import BICYCLE_MAP, CAR_MAP, ODOMETRY_MAP, VELOCITY_MAP, Json, as_columns, steps

NUMBER = st.floats(-1e9, 1e9)
LANDMARK = st.text(st.characters(exclude_categories=["C", "Z"]), min_size=1, max_size=128)


def read(type_: str, body: Json, config: Json = ODOMETRY_MAP) -> Decoded:
    core = parse(MAP_REQUEST, json.dumps(config).encode()).to_core()
    return decode(type_, json.dumps(body).encode(), core, "r1")


ENCOUNTER = st.fixed_dictionaries(
    {"robot": st.sampled_from(["r2", "r3"]), "x": NUMBER, "y": NUMBER},
    optional={"covariance": st.just([[1.0, 0.2], [0.2, 0.5]])},
)


@st.composite
def any_rows(draw: st.DrawFn) -> Json:
    times = sorted(draw(st.sets(st.integers(0, 10**6), min_size=1, max_size=8)))
    covariances = st.sampled_from([None, [[1.0, 0.2], [0.2, 0.5]]])
    made = []
    for t in times:
        seen: list[Json] = []
        for _ in range(draw(st.integers(0, 3))):
            one: Json = {"landmark": draw(LANDMARK), "x": draw(NUMBER), "y": draw(NUMBER)}
            covariance = draw(covariances)
            seen.append(one | ({} if covariance is None else {"covariance": covariance}))
        step: Json = {"t": t / 10, "observations": seen}
        if draw(st.booleans()):
            step["encounters"] = draw(st.lists(ENCOUNTER, max_size=2))
        if draw(st.booleans()):
            step["odometry"] = {"dx": draw(NUMBER), "dy": draw(NUMBER), "dtheta": draw(NUMBER)}
        made.append(step)
    return {"sequence": draw(st.integers(1, 10**9)), "steps": made}


def columns_of(rows: Json) -> Json:
    """Return rows as columns, covariances and missing controls included."""
    moving = [k for k, step in enumerate(rows["steps"]) if "odometry" in step]
    whole = as_columns({**rows, "steps": [{"odometry": {"dx": 0, "dy": 0, "dtheta": 0}, **s} for s in rows["steps"]]})
    whole["control_step"] = moving
    whole["control"] = [[channel[k] for k in moving] for channel in whole["control"]]
    if not moving:
        del whole["control"], whole["control_step"]
    default = np.diag(np.square(ODOMETRY_MAP["observation"]["sigma"])).tolist()
    met = [(k, e) for k, step in enumerate(rows["steps"]) for e in step.get("encounters", ())]
    if met:
        whole["encounter"] = {
            "step": [k for k, _ in met],
            "robot": [e["robot"] for _, e in met],
            "z": [[e[name] for _, e in met] for name in ("x", "y")],
        }
        if any("covariance" in e for _, e in met):
            whole["encounter"]["covariance"] = [e.get("covariance", default) for _, e in met]
    seen = [o for step in rows["steps"] for o in step["observations"]]
    if any("covariance" in o for o in seen):
        whole["observation"]["covariance"] = [o.get("covariance", default) for o in seen]
    if not seen:
        del whole["observation"]
    return whole


@given(any_rows())
def test_rows_and_columns_of_equal_content_have_one_digest(rows: Json) -> None:
    one, other = read(ROWS_TYPE, rows), read(COLUMNS_TYPE, columns_of(rows))
    assert one.sequence == other.sequence == rows["sequence"]
    assert digest(encode_batch(one.batch)) == digest(encode_batch(other.batch))


def test_encounters_follow_the_landmarks_of_their_step() -> None:
    body = {"sequence": 1, "steps": [
        {"t": 0.1, "encounters": [{"robot": "r2", "x": 1.0, "y": 2.0}]},
        {"t": 0.25, "observations": [{"landmark": "a", "x": 3.0, "y": 4.0}, {"landmark": "b", "x": 5.0, "y": 6.0}],
         "encounters": [{"robot": "r3", "x": 7.0, "y": 8.0}, {"robot": "r2", "x": 9.0, "y": 10.0}]},
        {"t": 0.5, "observations": [{"landmark": "a", "x": 11.0, "y": 12.0}]},
    ]}  # fmt: skip
    columns = {
        "sequence": 1, "t": [0.1, 0.25, 0.5],
        "observation": {"step": [1, 1, 2], "landmark": ["a", "b", "a"], "z": [[3, 5, 11], [4, 6, 12]]},
        "encounter": {"step": [0, 1, 1], "robot": ["r2", "r3", "r2"], "z": [[1, 7, 9], [2, 8, 10]]},
    }  # fmt: skip
    for type_, content in ((ROWS_TYPE, body), (COLUMNS_TYPE, columns)):
        batch = read(type_, content).batch
        assert batch.observation_step.tolist() == [0, 1, 1, 1, 1, 2]
        assert batch.z.tolist() == [[1, 3, 5, 7, 9, 11], [2, 4, 6, 8, 10, 12]]
        assert batch.landmark == (
            encounter("r2", 0.1), "a", "b", encounter("r3", 0.25), encounter("r2", 0.25), "a")  # fmt: skip
        assert as_encounter(batch.landmark[3]) == ("r3", 0.25)
        assert batch.observation_covariance is None


def test_another_number_is_other_content() -> None:
    rows: Json = {"sequence": 1, "steps": steps(20)}
    first = encode_batch(read(ROWS_TYPE, rows).batch)
    rows["steps"][7]["odometry"]["dx"] = np.nextafter(rows["steps"][7]["odometry"]["dx"], 1e9)
    assert digest(encode_batch(read(ROWS_TYPE, rows).batch)) != digest(first)


def test_velocity_and_range_bearing_become_columns() -> None:
    body = {"sequence": 3, "steps": [
        {"t": 1.0},
        {"t": 2.0, "velocity": {"v": 1.5, "omega": -0.1},
         "observations": [{"landmark": "a", "range": 3.0, "bearing": 0.5},
                          {"landmark": "b", "range": 2, "bearing": 1}]},
    ]}  # fmt: skip
    batch = read(ROWS_TYPE, body, VELOCITY_MAP).batch
    np.testing.assert_array_equal(batch.t, [1.0, 2.0])
    np.testing.assert_array_equal(batch.control_step, [1])
    np.testing.assert_array_equal(batch.control, [[1.5], [-0.1]])
    np.testing.assert_array_equal(batch.observation_step, [1, 1])
    np.testing.assert_array_equal(batch.z, [[3.0, 2.0], [0.5, 1.0]])
    assert batch.landmark == ("a", "b")


def test_a_covariance_beside_a_default_is_filled_with_the_default() -> None:
    own = [[0.5, 0.1, 0.0], [0.1, 0.5, 0.0], [0.0, 0.0, 0.01]]
    made = steps(3)
    made[1]["odometry"]["covariance"] = own
    covariance = read(ROWS_TYPE, {"sequence": 1, "steps": made}).batch.control_covariance
    assert covariance is not None
    default = np.diag(np.square(ODOMETRY_MAP["motion"]["sigma"]))
    np.testing.assert_array_equal(covariance, [default, own, default])


@pytest.mark.parametrize(("config", "model"), [(BICYCLE_MAP, "bicycle"), (CAR_MAP, "ackermann")])
def test_controls_of_vehicles_become_columns(config: Json, model: str) -> None:
    controls = [{"speed": 1.5, "steer": -0.1}, {"speed": 2, "steer": 0.2}]
    rows = {"sequence": 1, "steps": [{"t": k + 1.0, model: c} for k, c in enumerate(controls)]}
    columns = {"sequence": 1, "t": [1.0, 2.0], "control": [[1.5, 2], [-0.1, 0.2]]}
    one, other = read(ROWS_TYPE, rows, config).batch, read(COLUMNS_TYPE, columns, config).batch
    np.testing.assert_array_equal(one.control, [[1.5, 2.0], [-0.1, 0.2]])
    assert encode_batch(one) == encode_batch(other)


def test_what_a_map_is_made_of_reaches_the_estimator() -> None:
    motion = parse(MAP_REQUEST, json.dumps(CAR_MAP).encode()).to_core().motion
    assert motion == MotionConfig("ackermann", (0.1, 0.02, 0.05), wheelbase=2.83, encoder_offset=0.76)
    motion = parse(MAP_REQUEST, json.dumps(BICYCLE_MAP).encode()).to_core().motion
    assert motion == MotionConfig("bicycle", (0.05, 0.02), "density", 1.1)


def test_a_covariance_beside_a_density_leaves_the_rest_to_the_model() -> None:
    own = [[0.5, 0.1, 0.0], [0.1, 0.5, 0.0], [0.0, 0.0, 0.01]]
    made = steps(3)
    made[1]["odometry"]["covariance"] = own
    config = {**ODOMETRY_MAP, "motion": {**ODOMETRY_MAP["motion"], "noise": "density"}}
    batch = read(ROWS_TYPE, {"sequence": 1, "steps": made}, config).batch
    core = parse(MAP_REQUEST, json.dumps(config).encode()).to_core()
    _, noises = increments(core.motion, batch, 0.0)
    expected = np.diag(np.square(core.motion.sigma)) * 0.1
    np.testing.assert_allclose(noises, np.array([expected, own, expected]), rtol=1e-12)


@pytest.mark.parametrize("t", [1.8e9, -5.0, 0.0])
def test_a_clock_may_count_from_1970_or_from_anywhere(t: float) -> None:
    assert read(ROWS_TYPE, {"sequence": 1, "steps": [{"t": t}]}).batch.t[0] == t
