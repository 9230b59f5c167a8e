"""Solves: waited for or not, shared, dropped with their map."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor

import httpx

from tests.service.support import ODOMETRY_MAP, Api, Server, batches


def test_a_solve_that_nobody_waits_for(api: Api) -> None:
    for batch in batches(3, 30):
        api.send(batch)
    answer = api.http.post(f"{api.root}/optimize", params={"wait": False})
    assert answer.status_code == 202
    assert answer.headers["location"] == f"{api.root}/solves/{answer.json()['number']}"
    for _ in range(500):
        state = api.http.get(answer.headers["location"]).json()
        if state["status"] == "done":
            break
        assert state["status"] in ("waiting", "running")
        time.sleep(0.02)
    assert state["status"] == "done"
    assert api.get("")["map_version"] >= state["map_version"]


def test_a_solve_takes_in_what_was_acknowledged_before(api: Api) -> None:
    made = batches(4, 15)
    for batch in made:
        api.send(batch)
        solved = api.optimize()
        pose = api.get("/robots/r1/pose", frame="map")
        assert pose["map_version"] >= solved["map_version"]
        assert pose["covariance_kind"] == "joined"


def test_an_empty_map_can_be_solved(api: Api) -> None:
    assert api.optimize()["map_version"] == api.get("")["map_version"]


def test_a_deleted_map_is_gone_and_its_id_is_free(server: Server) -> None:
    api = Api(server.url, "short-lived").make()
    made = batches(20, 30)
    with ThreadPoolExecutor(2) as pool:

        def send() -> list[int]:
            return [api.post(batch).status_code for batch in made]

        sending = pool.submit(send)
        solving = pool.submit(lambda: [api.http.post(f"{api.root}/optimize").status_code for _ in range(10)])
        time.sleep(0.1)
        assert api.http.delete(api.root).status_code == 204
        assert set(sending.result()) <= {200, 404}
        assert set(solving.result()) <= {200, 404}
    assert api.http.get(api.root).status_code == 404
    again = httpx.post(f"{server.url}/v1/maps", json={"id": "short-lived", **ODOMETRY_MAP})
    assert again.status_code == 201
    assert again.json()["counts"]["steps"] == 0
    assert api.send(made[0])["sequence"] == 1
    api.close()
