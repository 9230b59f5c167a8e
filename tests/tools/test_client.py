"""The client's bodies are what the service takes."""

from __future__ import annotations

import numpy as np
import orjson
import pytest

from service.client import Client, Unreachable, columns
from service.datasets import Dataset
from service.datasets.isam import parse_isam
from service.replaying import map_name
from service.wire.measurements import Columns
from submaps.measurements import Batch

RUN = [
    "ODOMETRY 0 1 1 0 0 1 0 0 1 0 1",
    "ODOMETRY 1 2 1 0 0 1 0 0 2 0 1",
    "LANDMARK 1 a 1 2 1 0.5 1",
]


def run() -> Dataset:
    return parse_isam(RUN, noise="sqrt_information", name="Ünder the trees", source="run.txt")


def test_columns_hold_the_batch_and_pass_the_services_own_validation() -> None:
    batch = run().columns
    body = orjson.loads(orjson.dumps(columns(3, batch), option=orjson.OPT_SERIALIZE_NUMPY))
    Columns.model_validate(body)
    assert body["sequence"] == 3
    assert body["control_step"] == [1, 2]
    assert body["observation"]["landmark"] == ["a"]
    np.testing.assert_array_equal(body["control"], batch.control)
    np.testing.assert_array_equal(body["control_covariance"], batch.control_covariance)
    np.testing.assert_array_equal(body["observation"]["covariance"], batch.observation_covariance)


def test_what_a_batch_does_not_have_is_left_out() -> None:
    none = np.zeros(0, dtype=np.int64)
    still = Batch(np.zeros(1), none, np.zeros((3, 0)), None, none, (), np.zeros((2, 0)), None)
    assert columns(1, still).keys() == {"sequence", "t"}


def test_a_data_set_gives_its_map_a_name_that_maps_can_have() -> None:
    assert map_name(run()) == "nder-the-trees"


@pytest.mark.parametrize("url", ["nowhere", "ftp://127.0.0.1", "http://127.0.0.1:port", "http://127.0.0.1:1"])
def test_an_address_where_no_service_can_be_is_unreachable(url: str) -> None:
    with pytest.raises(Unreachable, match=r"http://127\.0\.0\.1:8080|submaps serve"), Client(url) as client:
        client.request("GET", "/healthz")
