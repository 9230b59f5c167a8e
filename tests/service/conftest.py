"""One server for all tests that only talk to it; each makes maps of its own."""

from __future__ import annotations

import copy
import uuid
from collections.abc import Iterator
from contextlib import closing

import pytest

from tests.service.support import VELOCITY_MAP, Api, Json, Server, batches, serving


@pytest.fixture(scope="session")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server on an empty directory."""
    with serving(tmp_path_factory.mktemp("data")) as one:
        yield one


@pytest.fixture
def api(server: Server) -> Iterator[Api]:
    """A client of a new map: odometry and cartesian observations."""
    one = Api(server.url, f"m{uuid.uuid4().hex[:12]}").make()
    with closing(one):
        yield one


@pytest.fixture
def velocity_api(server: Server) -> Iterator[Api]:
    """A client of a new map: velocity, and range and bearing."""
    one = Api(server.url, f"m{uuid.uuid4().hex[:12]}").make(VELOCITY_MAP)
    with closing(one):
        yield one


def good() -> Json:
    """Return the batch that would be next: its first half is always left good."""
    return copy.deepcopy(batches(2, 6)[1])


@pytest.fixture
def unchanged(api: Api) -> Iterator[Api]:
    """A map with a batch in it, which the test must leave as it is."""
    first, second = batches(2, 6)
    api.send(first)
    before = api.everything()
    yield api
    assert api.everything() == before
    assert api.send(second)["sequence"] == 2  # and the robot goes on from there
