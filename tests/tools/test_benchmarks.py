"""The measuring tools as their users run them: real processes, tiny sizes."""

from __future__ import annotations

import csv
import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import orjson
import pytest

from benchmarks.support import worlds
from benchmarks.support.figures import Tally
from benchmarks.support.http import is_loopback
from benchmarks.support.traffic import rows
from benchmarks.support.worlds import WORLDS, Drive, park
from service.client import columns
from service.standalone import own_service
from service.wire.columns import COLUMNS_TYPE, ROWS_TYPE, decode
from submaps.atlas.joining import join
from submaps.config import MapConfig
from submaps.mapper import Mapper

TOOLS = ("scaling", "load", "onestep", "latency", "tenants", "memory")


def tool(name: str, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", f"benchmarks.{name}", *words],
        stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=180, check=False,
        env={**os.environ, "COLUMNS": "120"},
    )  # fmt: skip


@pytest.mark.parametrize("name", TOOLS)
def test_help_says_what_is_measured(name: str) -> None:
    said = tool(name, "--help")
    assert said.returncode == 0
    assert said.stdout.startswith(f"usage: python -m benchmarks.{name}")
    assert not said.stderr


def test_scaling_writes_what_it_shows(tmp_path: Path) -> None:
    table, picture = tmp_path / "scaling.csv", tmp_path / "scaling.png"
    said = tool(
        "scaling", "--landmarks", "50", "200", "--submaps", "10", "25", "--one-filter", "20", "40", "--naive", "20",
        "--rounds", "2", "--batches", "1", "--solve", "100", "--csv", str(table), "--plot", str(picture),
    )  # fmt: skip
    assert said.returncode == 0, said.stderr
    with table.open() as lines:
        found = list(csv.DictReader(lines))
    assert [(row["series"], row["landmarks"]) for row in found] == [
        ("atlas, 10 a sub-map", "50"), ("atlas, 10 a sub-map", "200"),
        ("atlas, 25 a sub-map", "50"), ("atlas, 25 a sub-map", "200"),
        ("one EKF, compiled O(N²)", "20"), ("one EKF, compiled O(N²)", "40"), ("one EKF, naive O(N³)", "20"),
    ]  # fmt: skip
    assert all(float(row["us_an_observation"]) > 0.0 and float(row["bytes_a_landmark"]) > 0.0 for row in found)
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert said.stdout.count("cost at 200 landmarks against 50") == 2
    assert said.stdout.count("a solve from nothing, 50 landmarks") == 2


def test_load_at_a_rate_answers_what_was_due() -> None:
    with own_service() as url:
        said = tool(
            "load", "--url", url, "--robots", "4", "--rate", "40", "--queries", "20", "--seconds", "2",
            "--warm-up", "0.5", "--steps", "3", "--world", "street", "--json",
        )  # fmt: skip
    assert said.returncode == 0, said.stderr
    found = json.loads(said.stdout)
    assert found["ingest"]["answered"] == pytest.approx(80, abs=4)
    assert found["queries"]["answered"] == pytest.approx(40, abs=8)
    assert found["ingest"]["errors"] == {}
    assert found["queries"]["errors"] == {}
    assert 0.0 < found["ingest"]["p50_ms"] <= found["ingest"]["p99_ms"] <= found["ingest"]["max_ms"]
    assert 0.0 < found["syncs_per_batch"] <= 2.0
    least, most = found["batches_of_a_robot"]["least"], found["batches_of_a_robot"]["most"]
    assert 19 <= least <= most <= 21


def test_load_starts_a_service_of_its_own_and_shows_tables() -> None:
    said = tool("load", "--robots", "2", "--rows", "--seconds", "1", "--warm-up", "0", "--world", "grid")
    assert said.returncode == 0, said.stderr
    assert all(part in said.stdout for part in ("ingest", "p99.9", "observations/s"))


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--url", "http://192.0.2.1:8080"), "--allow-remote"),
        (("--robots", "0"), "--robots: got 0"),
        (("--seconds", "inf"), "--seconds: got inf"),
        (("--rate", "nan"), "--rate: got nan"),
        (("--robots", "2", "--maps", "3"), "--maps: got 3"),
    ],
)
def test_load_refuses_what_makes_no_sense(words: tuple[str, ...], expected: str) -> None:
    said = tool("load", *words)
    assert said.returncode == 2
    assert expected in said.stderr


def test_load_says_where_nothing_answers() -> None:
    said = tool("load", "--url", "http://127.0.0.1:1", "--seconds", "1")
    assert said.returncode == 1
    assert "no service answers there" in said.stderr


@pytest.mark.parametrize(
    ("name", "words", "expected"),
    [
        ("onestep", ("--robots", "3", "--maps", "3", "--rounds", "1", "--seconds", "0.5"), ("(limit 3.00 x)",)),
        ("tenants", ("--maps", "5", "--seconds", "1"), ("5 robots on 5 maps", "(limit 2.00 x)")),
        ("memory", ("--landmarks", "40", "--submaps", "10"), ("memory by packed", "(limit 1.20 x)")),
        (
            "latency",
            ("--rounds", "1", "--blocks", "1", "--city-rate", "50", "--pose-robots", "1", "--pose-seconds", "1"),
            ("ingest p99, city by street", "pose p99, busy by idle"),
        ),
    ],
)
def test_each_measurement_runs_and_gives_its_verdict(
    name: str, words: tuple[str, ...], expected: tuple[str, ...]
) -> None:
    said = tool(name, *words)
    assert said.returncode == 0, said.stderr
    assert all(part in said.stdout for part in expected), said.stdout


# -- what they stand on --------------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(WORLDS))
def test_a_lap_ends_where_it_begins_and_no_step_is_longer_than_a_metre(name: str) -> None:
    lap = WORLDS[name]()
    pose = np.eye(3)
    for dx, dy, turn in lap.increments:
        c, s = math.cos(turn), math.sin(turn)
        pose = pose @ np.array([[c, -s, dx], [s, c, dy], [0.0, 0.0, 1.0]])
    length = lap.steps * worlds.STEP_M if lap.endless else 0.0
    assert np.allclose(pose, [[1.0, 0.0, length], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], atol=1e-6)
    assert np.all(np.hypot(lap.increments[:, 0], lap.increments[:, 1]) <= worlds.STEP_M + 1e-9)


@pytest.mark.parametrize("name", ["grid", "park"])
def test_what_is_seen_from_different_poses_is_one_landmark(name: str) -> None:
    """A landmark's place in the world is the same from wherever it is seen."""
    lap = WORLDS[name]()
    pose, places = np.eye(3), np.full((lap.landmarks, 2), np.nan)
    for k, (dx, dy, turn) in enumerate(lap.increments):
        for row in range(lap.offsets[k], lap.offsets[k + 1]):
            place = pose[:2, :2] @ lap.points[row] + pose[:2, 2]
            known = places[lap.seen[row]]
            assert np.isnan(known[0]) or np.allclose(place, known, atol=1e-6)
            places[lap.seen[row]] = place
        c, s = math.cos(turn), math.sin(turn)
        pose = pose @ np.array([[c, -s, dx], [s, c, dy], [0.0, 0.0, 1.0]])
    assert not np.isnan(places).any()


@pytest.mark.parametrize("landmarks", [20, 100, 999, 5000])
def test_a_park_shows_all_of_its_landmarks_and_as_many_at_once_whatever_its_size(landmarks: int) -> None:
    lap = park(landmarks)
    assert np.unique(lap.seen).shape[0] >= 0.95 * landmarks
    assert lap.seen.shape[0] / lap.steps == pytest.approx(5.0, abs=1.5)


def test_a_street_without_end_never_comes_back() -> None:
    lap = WORLDS["street"]()
    drive, step = Drive(lap), 500
    last: dict[str, int] = {}
    for k in range(0, 2 * lap.steps, step):
        batch = drive.next(step)
        for at, name in zip(batch.observation_step, batch.landmark, strict=True):
            assert k + at - last.get(name, int(k + at)) <= 1
            last[name] = int(k + at)
    assert len(last) > 1.9 * lap.landmarks


def test_batches_join_up_however_they_are_cut() -> None:
    """The drive that a solve finds ends where it began, in batches of any size."""
    lap = park(60)
    for steps in (7, 50):
        drive, mapper = Drive(lap, start=11), Mapper(MapConfig(worlds.MOTION, worlds.OBSERVATION))
        while drive.step < lap.steps:
            mapper.apply("robot", drive.next(min(steps, lap.steps - drive.step)))
        mapper.apply("robot", drive.next(1))
        mapper.install(join(mapper.problem()))
        end = mapper.view().pose("robot", "map")
        error = np.array([end.x, end.y, end.theta])
        assert error @ np.linalg.solve(end.covariance, error) < 16.3  # chi-square, 3 degrees, 0.999


@pytest.mark.parametrize("most", [None, 2, 0])
def test_rows_and_columns_say_the_same(most: int | None) -> None:
    drive = Drive(park(60))
    config = MapConfig(worlds.MOTION, worlds.OBSERVATION)
    for sequence in (1, 2):
        batch = drive.next(6, most)
        assert most is None or np.bincount(batch.observation_step, minlength=6).max() <= most
        as_columns = orjson.dumps(columns(sequence, batch), option=orjson.OPT_SERIALIZE_NUMPY)
        one = decode(ROWS_TYPE, orjson.dumps(rows(sequence, batch)), config, "r").batch
        other = decode(COLUMNS_TYPE, as_columns, config, "r").batch
        assert one.landmark == other.landmark == batch.landmark
        for name in ("t", "control_step", "control", "observation_step", "z"):
            assert np.array_equal(getattr(one, name), getattr(other, name))
            assert np.array_equal(getattr(one, name), getattr(batch, name))


def test_a_tally_counts_good_answers_and_faults() -> None:
    tally = Tally(seconds=2.0)
    for k in range(100):
        tally.add(k / 1000.0, 200)
    tally.add(9.0, 503)
    assert tally.answered == 100
    assert tally.rate == 50.0
    assert tally.errors == {"503": 1}
    assert tally.percentile(50) == pytest.approx(0.0495)
    assert tally.figures()["max_ms"] == pytest.approx(99.0)


@pytest.mark.parametrize(
    ("url", "own"),
    [
        ("http://127.0.0.1:8080", True), ("http://localhost:1", True), ("http://[::1]:80", True),
        ("http://10.0.0.1", False), ("http://localhost.example.com", False), ("http://", False),
    ],
)  # fmt: skip
def test_only_loopback_is_loopback(url: str, own: bool) -> None:
    assert is_loopback(url) is own
