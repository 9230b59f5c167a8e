"""The client's bodies are what the service takes."""

from __future__ import annotations

import numpy as np
import orjson
import pytest

from service.client import Client, Unreachable, columns, settings
from service.datasets import Dataset
from service.datasets.isam import parse_isam
from service.replaying import map_name
from service.wire.base import parse
from service.wire.maps import CONFIG
from service.wire.measurements import Columns
from submaps.config import MapConfig, MotionConfig, ObservationConfig
from submaps.measurements import Batch, as_encounter
from tests.tools.fleet import drive

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


def test_sightings_of_other_robots_are_a_block_of_their_own() -> None:
    batch = drive(1.0).robots["bob"]
    body = orjson.loads(orjson.dumps(columns(1, batch), option=orjson.OPT_SERIALIZE_NUMPY))
    Columns.model_validate(body)
    of_landmarks = np.array([as_encounter(name) is None for name in batch.landmark])
    assert body["observation"]["landmark"] == [name for name in batch.landmark if as_encounter(name) is None]
    assert set(body["encounter"]["robot"]) == {"ann"}
    for block, rows in ((body["observation"], of_landmarks), (body["encounter"], ~of_landmarks)):
        assert block["step"] == batch.observation_step[rows].tolist()
        np.testing.assert_array_equal(block["z"], batch.z[:, rows])


@pytest.mark.parametrize(
    "motion",
    [
        MotionConfig("odometry", (0.1, 0.2, 0.3)),
        MotionConfig("velocity", (0.1, 0.2, 0.3), noise="density"),
        MotionConfig("bicycle", (0.1, 0.2), wheelbase=1.5),
        MotionConfig("ackermann", (0.1, 0.2), wheelbase=2.8, encoder_offset=0.7),
    ],
)
def test_settings_are_those_that_the_service_takes(motion: MotionConfig) -> None:
    sensor = ObservationConfig("range_bearing", (0.1, 0.2), (1.0, 2.0, 0.5))
    config = MapConfig(motion, sensor, "standard", 0.999, 33, 0.02, 7, 0.4)
    assert parse(CONFIG, orjson.dumps(settings(config))).to_core() == config


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
