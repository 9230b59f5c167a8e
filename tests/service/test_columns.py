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
from tests.service.support import ODOMETRY_MAP, VELOCITY_MAP, Json, as_columns, steps

NUMBER = st.floats(-1e9, 1e9)
LANDMARK = st.text(st.characters(exclude_categories=["C", "Z"]), min_size=1, max_size=128)


def read(type_: str, body: Json, config: Json = ODOMETRY_MAP) -> Decoded:
    core = parse(MAP_REQUEST, json.dumps(config).encode()).to_core()
    return decode(type_, json.dumps(body).encode(), core)


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
    seen = [o for step in rows["steps"] for o in step["observations"]]
    if any("covariance" in o for o in seen):
        default = np.diag(np.square(ODOMETRY_MAP["observation"]["sigma"])).tolist()
        whole["observation"]["covariance"] = [o.get("covariance", default) for o in seen]
    if not seen:
        del whole["observation"]
    return whole


@given(any_rows())
def test_rows_and_columns_of_equal_content_have_one_digest(rows: Json) -> None:
    one, other = read(ROWS_TYPE, rows), read(COLUMNS_TYPE, columns_of(rows))
    assert one.sequence == other.sequence == rows["sequence"]
    assert digest(encode_batch(one.batch)) == digest(encode_batch(other.batch))


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


@pytest.mark.parametrize("t", [1.8e9, -5.0, 0.0])
def test_a_clock_may_count_from_1970_or_from_anywhere(t: float) -> None:
    assert read(ROWS_TYPE, {"sequence": 1, "steps": [{"t": t}]}).batch.t[0] == t
