"""Whatever is wrong with a request is named, and leaves the map as it was."""

from __future__ import annotations

import json
import uuid
from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Any

import pytest

from submaps.measurements import encounter
from tests.service.conftest import good
from tests.service.support import BICYCLE_MAP, CAR_MAP, COLUMNS_TYPE, Api, Json, Server, as_columns, check, problem

Change = Callable[[Json], Any]
NAN, INF = float("nan"), float("inf")


def step(body: Json) -> Json:
    last: Json = body["steps"][5]
    return last


def seen(body: Json) -> Json:
    first: Json = body["steps"][5]["observations"][0]
    return first


def put(target: Callable[[Json], Json], name: str, value: Any) -> Change:
    def change(body: Json) -> None:
        target(body)[name] = value

    return change


def whole(body: Json) -> Json:
    return body


MET = {"robot": "r2", "x": 3.0, "y": 0.1}
STEP, SEEN = "steps.5", "steps.5.observations.0"

ROWS: dict[str, tuple[Change, str, str]] = {
    "no steps": (put(whole, "steps", []), "steps", "at least 1"),
    "steps of the wrong type": (put(whole, "steps", {"t": 1}), "steps", "valid array"),
    "a step of the wrong type": (lambda b: b["steps"].append(7), "steps.6", "got 7"),
    "sequence 0": (put(whole, "sequence", 0), "sequence", "got 0"),
    "sequence of the wrong type": (put(whole, "sequence", "2"), "sequence", 'got "2"'),
    "sequence not whole": (put(whole, "sequence", 2.5), "sequence", "got 2.5"),
    "no sequence": (lambda b: b.pop("sequence"), "sequence", "required"),
    "an unknown field": (put(whole, "robot", "r1"), "robot", "unknown field"),
    "an unknown field in a step": (put(step, "speed", 1), f"{STEP}.speed", "unknown field"),
    "an unknown field in a control": (put(lambda b: step(b)["odometry"], "dz", 1), f"{STEP}.odometry.dz", "unknown"),
    "an unknown field in an observation": (put(seen, "z", 1), f"{SEEN}.z", "unknown field"),
    "no time": (lambda b: step(b).pop("t"), f"{STEP}.t", "required"),
    "time not a number": (put(step, "t", NAN), f"{STEP}.t", "finite"),
    "time of the wrong type": (put(step, "t", "1.0"), f"{STEP}.t", "valid number"),
    "time true": (put(step, "t", True), f"{STEP}.t", "valid number"),
    "time beyond all clocks": (put(step, "t", 1e12), f"{STEP}.t", "less than"),
    "time backwards inside the batch": (put(step, "t", 1.05), f"{STEP}.t", "after the step before"),
    "time standing still with a control": (put(step, "t", 1.1), f"{STEP}.t", "after the step before"),
    "time before the last batch": (put(lambda b: b["steps"][0], "t", 0.3), "steps.0.t", "end of batch 1"),
    "time equal to the last batch": (put(lambda b: b["steps"][0], "t", 0.6), "steps.0.t", "end of batch 1"),
    "infinite control": (put(lambda b: step(b)["odometry"], "dx", INF), f"{STEP}.odometry.dx", "finite"),
    "huge control": (put(lambda b: step(b)["odometry"], "dx", 1e10), f"{STEP}.odometry.dx", "less than"),
    "control of another model": (put(step, "velocity", {"v": 1, "omega": 0}), f"{STEP}.velocity", "odometry"),
    "control of a vehicle": (put(step, "bicycle", {"speed": 1, "steer": 0}), f"{STEP}.bicycle", "odometry"),
    "control of another vehicle": (put(step, "ackermann", {"speed": 1, "steer": 0}), f"{STEP}.ackermann", "odometry"),
    "control of an unknown model": (put(step, "tracks", {"left": 1, "right": 0}), f"{STEP}.tracks", "odometry"),
    "half a control": (put(step, "odometry", {"dx": 1, "dy": 0}), f"{STEP}.odometry.dtheta", "required"),
    "not a number": (put(seen, "x", NAN), f"{SEEN}.x", "finite"),
    "infinite": (put(seen, "y", -INF), f"{SEEN}.y", "finite"),
    "huge": (put(seen, "y", -2e9), f"{SEEN}.y", "greater than"),
    "beyond what a number can be": (put(seen, "x", 10**400), f"{SEEN}.x", "finite"),
    "a number as text": (put(seen, "x", "1"), f"{SEEN}.x", "valid number"),
    "null": (put(seen, "x", None), f"{SEEN}.x", "valid number"),
    "a landmark's id as a number": (put(seen, "landmark", 7), f"{SEEN}.landmark", "valid string"),
    "an empty landmark's id": (put(seen, "landmark", ""), f"{SEEN}.landmark", "at least 1"),
    "a long landmark's id": (put(seen, "landmark", "x" * 129), f"{SEEN}.landmark", "at most 128"),
    "an unprintable landmark's id": (put(seen, "landmark", "a\nb"), f"{SEEN}.landmark", "printable"),
    "an encounter's name as a landmark's id":
        (put(seen, "landmark", encounter("r2", 1.0)), f"{SEEN}.landmark", "printable"),
    "no landmark": (lambda b: seen(b).pop("landmark"), f"{SEEN}.landmark", "required"),
    "a covariance with a negative eigenvalue":
        (put(seen, "covariance", [[1, 2], [2, 1]]), f"{SEEN}.covariance", "positive definite"),
    "a covariance of zeros": (put(seen, "covariance", [[0, 0], [0, 0]]), f"{SEEN}.covariance", "positive definite"),
    "a singular covariance": (put(seen, "covariance", [[1, 1], [1, 1]]), f"{SEEN}.covariance", "positive definite"),
    "a covariance that is not symmetric":
        (put(seen, "covariance", [[1, 0.1], [0.2, 1]]), f"{SEEN}.covariance", "symmetric"),
    "a covariance of another size": (put(seen, "covariance", [[1]]), f"{SEEN}.covariance", "2 lists of 2"),
    "an empty covariance": (put(seen, "covariance", []), f"{SEEN}.covariance", "2 lists of 2"),
    "a ragged covariance": (put(seen, "covariance", [[1, 0], [1]]), f"{SEEN}.covariance", "2 lists of 2"),
    "a control's covariance that is not positive definite":
        (put(lambda b: step(b)["odometry"], "covariance", [[1, 0, 0], [0, -1, 0], [0, 0, 1]]),
         f"{STEP}.odometry.covariance", "positive definite"),
    "an encounter with itself":
        (put(step, "encounters", [MET, {**MET, "robot": "r1"}]), f"{STEP}.encounters.1.robot", "itself"),
    "an encounter with no robot":
        (put(step, "encounters", [{"x": 1.0, "y": 0.0}]), f"{STEP}.encounters.0.robot", "required"),
    "an encounter with a landmark":
        (put(step, "encounters", [{**MET, "landmark": "7"}]), f"{STEP}.encounters.0.landmark", "unknown field"),
    "an encounter with what is no name":
        (put(step, "encounters", [{**MET, "robot": "R 2"}]), f"{STEP}.encounters.0.robot", "pattern"),
    "an encounter as range and bearing":
        (put(step, "encounters", [{"robot": "r2", "range": 3.0, "bearing": 0.1}]), f"{STEP}.encounters.0.x",
         "cartesian"),
    "an encounter's covariance that is singular":
        (put(step, "encounters", [MET, {**MET, "covariance": [[1, 1], [1, 1]]}]), f"{STEP}.encounters.1.covariance",
         "positive definite"),
    "observations as range and bearing":
        (put(step, "observations", [{"landmark": "1", "range": 3.0, "bearing": 0.1}]), f"{SEEN}.x", "cartesian"),
}  # fmt: skip


@pytest.mark.parametrize("name", ROWS)
def test_bad_rows(unchanged: Api, name: str) -> None:
    change, path, message = ROWS[name]
    body = good()
    change(body)
    check(unchanged, unchanged.post(body), 422, path, message)


def landmarks(body: Json) -> Json:
    columns: Json = body["observation"]
    return columns


MEETING = {"step": [1, 4], "robot": ["r2", "r3"], "z": [[3.0, 2.5], [0.1, 0.2]]}
COLUMNS: dict[str, tuple[Change, str, str]] = {
    "no steps": (put(whole, "t", []), "t", "at least 1"),
    "time backwards": (lambda b: b["t"].__setitem__(5, 1.05), "t.5", "after the step before"),
    "time before the last batch": (lambda b: b["t"].__setitem__(0, 0.2), "t.0", "end of batch 1"),
    "not a number": (lambda b: b["control"][1].__setitem__(4, NAN), "control.1.4", "finite"),
    "huge": (lambda b: b["control"][1].__setitem__(4, 1e10), "control.1.4", "less than"),
    "a channel short": (lambda b: b["control"].pop(), "control", "expected 3: dx, dy, dtheta"),
    "a channel too many": (lambda b: b["control"].append([0.0] * 6), "control", "expected 3"),
    "a control short": (lambda b: b["control"][2].pop(), "control.2", "expected 6"),
    "a control's step twice": (put(whole, "control_step", [0, 1, 2, 3, 3, 5]), "control_step.4", "rising"),
    "a control's step beyond the end": (put(whole, "control_step", [0, 1, 2, 3, 4, 6]), "control_step.5", "0 to 5"),
    "a control's step below 0": (put(whole, "control_step", [-1, 1, 2, 3, 4, 5]), "control_step.0", "greater"),
    "steps of no control": (lambda b: b.pop("control") and b.update(control_step=[0]), "control_step", "without"),
    "an unknown field": (put(whole, "steps", []), "steps", "unknown field"),
    "an observation's step beyond the end":
        (lambda b: landmarks(b)["step"].__setitem__(-1, 6), "observation.step.LAST", "0 to 5"),
    "observations out of order": (lambda b: landmarks(b)["step"].__setitem__(0, 5), "observation.step.1", "order"),
    "a landmark short": (lambda b: landmarks(b)["landmark"].pop(), "observation.landmark", "one for each"),
    "a landmark's id as a number":
        (lambda b: landmarks(b)["landmark"].__setitem__(1, 7), "observation.landmark.1", "valid string"),
    "an empty landmark's id":
        (lambda b: landmarks(b)["landmark"].__setitem__(1, ""), "observation.landmark.1", "at least 1"),
    "a channel of observations short": (lambda b: landmarks(b)["z"].pop(), "observation.z", "expected 2: x, y"),
    "an observation short": (lambda b: landmarks(b)["z"][0].pop(), "observation.z.0", "one each"),
    "an infinite observation": (lambda b: landmarks(b)["z"][0].__setitem__(2, INF), "observation.z.0.2", "finite"),
    "covariances short": (put(landmarks, "covariance", [[[1, 0], [0, 1]]]), "observation.covariance", "one each"),
    "a covariance that is not positive definite":
        (lambda b: landmarks(b).update(covariance=[[[1, 0], [0, 1]]] * (len(landmarks(b)["step"]) - 1)
                                       + [[[1, 3], [3, 1]]]), "observation.covariance.LAST", "positive definite"),
    "an encounter's step beyond the end":
        (put(whole, "encounter", {**MEETING, "step": [1, 6]}), "encounter.step.1", "0 to 5"),
    "encounters out of order": (put(whole, "encounter", {**MEETING, "step": [4, 1]}), "encounter.step.1", "order"),
    "a robot short": (put(whole, "encounter", {**MEETING, "robot": ["r2"]}), "encounter.robot", "one for each"),
    "no robot's name": (put(whole, "encounter", {**MEETING, "robot": ["r2", "?"]}), "encounter.robot.1", "pattern"),
    "an encounter with itself":
        (put(whole, "encounter", {**MEETING, "robot": ["r2", "r1"]}), "encounter.robot.1", "itself"),
    "an encounter short": (put(whole, "encounter", {**MEETING, "z": [[1.0], [2.0, 3.0]]}), "encounter.z.0", "one each"),
    "an encounter's covariance short":
        (put(whole, "encounter", {**MEETING, "covariance": [[[1, 0], [0, 1]]]}), "encounter.covariance", "one each"),
    "a control's covariance short":
        (put(whole, "control_covariance", [[[1, 0, 0], [0, 1, 0], [0, 0, 1]]]), "control_covariance", "one each"),
}  # fmt: skip


@pytest.mark.parametrize("name", COLUMNS)
def test_bad_columns(unchanged: Api, name: str) -> None:
    change, path, message = COLUMNS[name]
    body = as_columns(good())
    last = len(body["observation"]["step"]) - 1
    change(body)
    check(unchanged, unchanged.post(body, type_=COLUMNS_TYPE), 422, path.replace("LAST", str(last)), message)


BROKEN = [b"", b"{", b"nonsense", b'{"sequence": 2', b"\xff\xfe", b'{"a": "\\ud800"}', b"[" * 10**5]


@pytest.mark.parametrize("body", BROKEN, ids=[str(b[:12]) for b in BROKEN])
@pytest.mark.parametrize("type_", ["application/json", COLUMNS_TYPE])
def test_broken_json(unchanged: Api, body: bytes, type_: str) -> None:
    assert problem(unchanged.post(body, type_=type_), 400)["type"] == "not-json"


@pytest.mark.parametrize("body", [b"null", b"3", b"[]", b'"text"'])
def test_json_that_is_no_batch(unchanged: Api, body: bytes) -> None:
    problem(unchanged.post(body), 422)


@pytest.mark.parametrize("type_", ["text/plain", "", "application/jsonn", "application/json; charset=latin-1"])
def test_wrong_content_type(unchanged: Api, type_: str) -> None:
    answer = unchanged.post(good(), type_=type_)
    assert problem(answer, 415)["type"] == "unsupported-media-type"
    assert COLUMNS_TYPE in answer.json()["detail"]


def test_compressed_bodies_are_refused(unchanged: Api) -> None:
    answer = unchanged.http.post(
        f"{unchanged.root}/robots/r1/measurements",
        content=b"x",
        headers={"Content-Type": "application/json", "Content-Encoding": "gzip"},
    )
    assert "gzip" in problem(answer, 415)["detail"]


def test_a_body_too_large(unchanged: Api) -> None:
    body = json.dumps(good()).encode() + b" " * (16 * 2**20)
    assert problem(unchanged.post(body), 413)["limit"] == 16 * 2**20


def test_a_body_too_large_of_unknown_length(unchanged: Api) -> None:
    def chunks() -> Iterator[bytes]:
        for _ in range(17):
            yield b" " * 2**20

    answer = unchanged.http.post(
        f"{unchanged.root}/robots/r1/measurements", content=chunks(), headers={"Content-Type": "application/json"}
    )
    problem(answer, 413)


def test_a_body_as_large_as_may_be(unchanged: Api) -> None:
    body = json.dumps({**good(), "sequence": 9}).encode()
    answer = unchanged.post(body + b" " * (16 * 2**20 - len(body)))
    assert problem(answer, 409)["type"] == "sequence-gap"


def test_sequence_gap_and_conflict(unchanged: Api) -> None:
    gap = problem(unchanged.post({**good(), "sequence": 4}), 409)
    assert (gap["type"], gap["expected"]) == ("sequence-gap", 2)
    conflict = problem(unchanged.post({**good(), "sequence": 1}), 409)
    assert (conflict["type"], conflict["expected"]) == ("sequence-conflict", 2)


def test_a_first_batch_has_sequence_1(unchanged: Api) -> None:
    gap = problem(unchanged.post(good(), robot="r2"), 409)
    assert (gap["type"], gap["expected"]) == ("sequence-gap", 1)


def test_content_comes_before_sequence(unchanged: Api) -> None:
    check(unchanged, unchanged.post({**good(), "sequence": 9, "steps": []}), 422, "steps")


@pytest.mark.parametrize(("config", "model", "steer", "message"), [
    (BICYCLE_MAP, "bicycle", 3.2, "within 3.142 rad"),
    (CAR_MAP, "ackermann", -1.6, "within 1.5 rad"),
    (CAR_MAP, "ackermann", 1.4, "encoder_offset / wheelbase above 0.05"),
])  # fmt: skip
def test_a_steer_that_no_vehicle_can_follow(
    server: Server, config: Json, model: str, steer: float, message: str
) -> None:
    with closing(Api(server.url, f"m{uuid.uuid4().hex[:12]}").make(config)) as api:
        rows = {"sequence": 1, "steps": [{"t": 1.0}, {"t": 2.0, model: {"speed": 1.0, "steer": steer}}]}
        check(api, api.post(rows), 422, f"steps.1.{model}.steer", message)
        columns = {"sequence": 1, "t": [1.0, 2.0], "control": [[1.0, 1.0], [0.1, steer]]}
        check(api, api.post(columns, type_=COLUMNS_TYPE), 422, "control.1.1", message)
        assert api.get("")["counts"]["steps"] == 0
        assert api.get("")["config"]["motion"] == config["motion"]
