"""Measurements that are taken in without the framework are answered as with it."""

from __future__ import annotations

import asyncio
from pathlib import Path

import httpx
import pytest

from service.app import create_app
from service.settings import Settings
from tests.service.support import Api, Server, batches, problem

PATH = "/v1/maps/park/robots/r1/measurements"


def test_names_may_be_percent_encoded(api: Api) -> None:
    first, second = batches(2, 2)
    assert api.send(first)["sequence"] == 1
    answer = api.http.post(f"{api.root}/robots/%72%31/measurements", json=second)
    assert (answer.status_code, answer.json()["sequence"]) == (200, 2)
    assert answer.headers["content-type"] == "application/json"
    assert int(answer.headers["content-length"]) == len(answer.content)


def test_other_methods_are_refused(api: Api) -> None:
    for method in ("GET", "PUT", "DELETE"):
        answer = api.http.request(method, f"{api.root}/robots/r1/measurements")
        problem(answer, 405)
        assert answer.headers["allow"] == "POST"
    problem(api.http.post(f"{api.root}/robots/r1/measurements/", json=batches(1, 2)[0]), 404)


def test_good_and_refused_ones_are_counted_by_route(server: Server, api: Api) -> None:
    api.send(batches(1, 2)[0])
    problem(api.http.post(f"{api.root}/robots/r1/measurements", content=b"{"), 415)
    text = httpx.get(f"{server.url}/metrics").text
    for status in (200, 415):
        labels = f'method="POST",route="/v1/maps/{{map}}/robots/{{robot}}/measurements",status="{status}"'
        assert f"submaps_request_seconds_count{{{labels}}}" in text


def test_a_problem_is_the_same_by_both_ways(tmp_path: Path) -> None:
    app = create_app(Settings.from_environment({}, data_dir=tmp_path))

    async def ask(root: str) -> httpx.Response:
        transport = httpx.ASGITransport(app, root_path=root)
        async with httpx.AsyncClient(transport=transport, base_url="http://here") as client:
            return await client.post(root + PATH, json=batches(1, 2)[0])

    direct, framework = (asyncio.run(ask(root)) for root in ("", "/behind"))  # a root path is left to the framework
    problem(direct, 503)
    assert direct.content == framework.content
    assert direct.headers == framework.headers
    app.state.engine.journal.close()


@pytest.mark.parametrize("step", [1, 2**70])
def test_a_step_that_is_not_there_is_named(api: Api, step: int) -> None:
    body = {"sequence": 1, "t": [0.1], "observation": {"step": [step], "landmark": ["7"], "z": [[1.0], [0.0]]}}
    answer = api.http.post(
        f"{api.root}/robots/r1/measurements", json=body,
        headers={"content-type": "application/vnd.submaps.columns+json"},
    )  # fmt: skip
    assert problem(answer, 422)["errors"][0]["path"] == "observation.step.0"
