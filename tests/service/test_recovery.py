"""What was acknowledged is there after a power cut, and a replay reaches the same bits."""

from __future__ import annotations

import threading
import time
from contextlib import closing
from pathlib import Path

import httpx
import pytest

from tests.service.support import Api, Json, batches, serving, start


def comparable(everything: Json) -> Json:
    """Return what does not depend on when solves happened to finish."""
    return {
        "robots": everything["robots"],
        "odom": [pose | {"map_version": 0} for pose in everything["poses"] if pose["frame"] == "odom"],
        "submaps": [{**one, "pose": None, "covariance": None} for one in everything["submaps"]],
        "landmarks": [one["id"] for one in everything["landmarks"]],
    }


def test_a_restart_reaches_the_same_bits(tmp_path: Path) -> None:
    with serving(tmp_path) as server, closing(Api(server.url, "park").make()) as api:
        for batch in batches(12, 20):
            api.send(batch)
            api.send({**batch, "steps": batch["steps"][::2]}, "r2")
            if batch["sequence"] % 4 == 0:
                api.optimize()
        # A solve that was begun on its own may still be on its way in.
        before = settled(api)
        assert before["map"]["map_version"] >= 3
        server.kill()
    with serving(tmp_path) as server, closing(Api(server.url, "park")) as api:
        assert api.everything() == before
        solves = api.get("/solves/1")
        assert solves["status"] == "done"
    # What the first replay wrote along the way changes nothing either.
    with serving(tmp_path) as server, closing(Api(server.url, "park")) as api:
        assert api.everything() == before


def settled(api: Api) -> Json:
    """Return everything about a map once no solve is on its way."""
    everything = api.everything()
    for _ in range(100):
        time.sleep(0.1)
        again = api.everything()
        if again == everything:
            return again
        everything = again
    raise AssertionError("the map does not come to rest")


class Robot(threading.Thread):
    """Sends batch after batch to a map of its own until the server is gone."""

    def __init__(self, url: str, name: str, made: list[Json]) -> None:
        super().__init__()
        self.api = Api(url, name)
        self.made = made
        self.acknowledged: list[Json] = []

    def run(self) -> None:
        with closing(self.api):
            for batch in self.made:
                try:
                    self.acknowledged.append(self.api.send(batch))
                except httpx.TransportError:
                    return


@pytest.mark.parametrize("seconds", [0.05, 0.4, 1.0])
def test_nothing_acknowledged_is_lost_when_killed_under_load(tmp_path: Path, seconds: float) -> None:
    made = {f"m{k}": batches(400, 4, seed=k) for k in range(3)}
    server = start(tmp_path)
    for name in made:
        with closing(Api(server.url, name).make()):
            pass
    robots = [Robot(server.url, name, made[name]) for name in made]
    for robot in robots:
        robot.start()
    time.sleep(seconds)
    server.kill()
    for robot in robots:
        robot.join()
    assert any(robot.acknowledged for robot in robots)
    with serving(tmp_path) as server:
        for robot in robots:
            with closing(Api(server.url, robot.api.id)) as api:
                check_and_go_on(api, robot)


def check_and_go_on(api: Api, robot: Robot) -> None:
    """Check that each acknowledgement holds, then send on, and compare with a map that saw no cut."""
    count = len(robot.acknowledged)
    for batch, acknowledged in zip(robot.made[:count][-5:], robot.acknowledged[-5:], strict=True):
        assert api.send(batch) == {**acknowledged, "duplicate": True}
    # The batch that was on its way may have been kept: only its answer was lost.
    kept = api.get("")["counts"]["steps"]
    assert kept in (4 * count, 4 * count + 4)
    until = min(count + 20, len(robot.made))
    for batch in robot.made[count:until]:
        api.send(batch)
    with closing(Api(str(api.http.base_url), f"{api.id}-whole").make()) as whole:
        for batch in robot.made[:until]:
            whole.send(batch)
        assert comparable(api.everything()) == comparable(whole.everything())


def test_a_deleted_map_stays_deleted(tmp_path: Path) -> None:
    with serving(tmp_path) as server, closing(Api(server.url, "park").make()) as api:
        api.send(batches(1, 5)[0])
        api.http.delete(api.root)
        api.make()
        server.kill()
    with serving(tmp_path) as server, closing(Api(server.url, "park")) as api:
        assert api.get("")["counts"]["steps"] == 0
