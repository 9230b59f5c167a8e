"""A batch counts once, however often it is sent."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

from tests.service.support import COLUMNS_TYPE, Api, as_columns, batches


def test_a_repeat_gets_the_first_acknowledgement(api: Api) -> None:
    first, second = batches(2, 10)
    acknowledged = api.send(first)
    assert acknowledged["duplicate"] is False
    api.send(second)
    before = api.everything()
    assert api.send(first) == {**acknowledged, "duplicate": True}
    assert api.post(as_columns(first), type_=COLUMNS_TYPE).json() == {**acknowledged, "duplicate": True}
    assert api.everything() == before


def test_repeats_at_the_same_moment_count_once(api: Api) -> None:
    (only,) = batches(1, 50)
    with ThreadPoolExecutor(8) as pool:
        answers = [answer.json() for answer in pool.map(lambda _: api.post(only), range(8))]
    assert sorted(answer["duplicate"] for answer in answers) == [False] + [True] * 7
    assert len({str({**answer, "duplicate": None}) for answer in answers}) == 1
    assert api.get("")["counts"]["steps"] == 50


def test_acknowledgements_are_kept_for_the_last_thousand(api: Api) -> None:
    made = batches(1003, 1)
    for batch in made:
        api.send(batch)
    assert api.send(made[3])["duplicate"] is True
    answer = api.post(made[2])
    assert (answer.status_code, answer.json()["type"]) == (409, "sequence-too-old")


def test_a_step_without_control_may_share_its_time(api: Api) -> None:
    (first,) = batches(1, 3)
    api.send(first)
    last = first["steps"][-1]["t"]
    seen = {"t": last, "observations": [{"landmark": "0", "x": 1.0, "y": 2.0}]}
    assert api.send({"sequence": 2, "steps": [seen, seen]})["steps"] == 2
    assert api.post({"sequence": 3, "steps": [{"t": last - 0.01}]}).status_code == 422


def test_robots_count_for_themselves(api: Api) -> None:
    first, second = batches(2, 5)
    for body in (first, second):
        for robot in ("r1", "r2"):
            assert api.send(body, robot)["sequence"] == body["sequence"]
    assert [robot["id"] for robot in api.all_of("robots")] == ["r1", "r2"]
