"""The commands for several robots and for the truth: replay, evaluate, export."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from service.commands.console import INPUT, REFUSED
from service.datasets.tum import read_tum
from submaps.config import ObservationConfig
from tests.tools.fleet import drive, write_mrclam
from tests.tools.support import submaps


@pytest.fixture(scope="module")
def two_robots(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of two robots that see the same landmarks and one another."""
    folder = tmp_path_factory.mktemp("runs") / "mrclam_two"
    write_mrclam(drive(1.0, observation=ObservationConfig("range_bearing", (0.05, 0.02))), folder)
    return folder


@pytest.fixture(scope="module")
def two_on_a_map(two_robots: Path, url: str) -> dict[str, Any]:
    """What was told of the replay of both to the map ``two``."""
    answer = submaps("replay", str(two_robots), "--url", url, "--map", "two", "--json")
    assert answer.returncode == 0, answer.stderr
    told: dict[str, Any] = json.loads(answer.stdout)
    return told


def test_replay_tells_of_each_robot_and_of_the_truth(two_on_a_map: dict[str, Any]) -> None:
    told = two_on_a_map
    assert told["landmarks"] == 6
    assert set(told["robots"]) == {"robot1", "robot2"}
    for part in told["robots"].values():
        assert part["connected"]
        assert part["absolute_trajectory_rmse"] < 0.3
    assert sum(part["steps"] for part in told["robots"].values()) == told["steps"]
    assert told["landmark_rmse"] < 0.1
    assert told["landmark_rmse_to_truth"] < 0.15
    assert told["batch_landmark_rmse_to_truth"] < 0.15


def test_replay_shows_robots_and_notes_in_tables(two_robots: Path, url: str) -> None:
    answer = submaps("replay", str(two_robots), "--url", url, "--map", "shown", "--no-batch")
    assert answer.returncode == 0, answer.stderr
    for words in ("robot1", "robot2", "rejected", "connected", "ATE", "landmark RMSE to the truth"):
        assert words in answer.stdout
    assert "batch optimum" not in answer.stdout


def test_evaluate_compares_a_map_with_its_truth(two_robots: Path, two_on_a_map: dict[str, Any], url: str) -> None:
    words = ("evaluate", "--truth", str(two_robots), "--url", url, "--map", "two")
    answer = submaps(*words, "--json")
    assert answer.returncode == 0, answer.stderr
    told = json.loads(answer.stdout)
    assert told["landmarks_m"]["rmse"] == pytest.approx(two_on_a_map["landmark_rmse_to_truth"], rel=1e-9)
    assert told["landmarks_m"]["count"] == 6
    assert 0.0 < told["landmark_nees"] < 5.0
    assert 0.0 < told["pose_nees"] < 10.0
    for robot, error in told["robots"].items():
        assert error["absolute"]["rmse"] <= error["common"]["rmse"] + 1e-12
        expected = two_on_a_map["robots"][robot]["absolute_trajectory_rmse"]
        assert error["absolute"]["rmse"] == pytest.approx(expected, rel=1e-9)
    table = submaps(*words)
    assert table.returncode == 0
    for label in ("RMSE of 6 landmarks", "NEES", "robot2", "ATE", "RPE, 1 meters"):
        assert label in table.stdout


def test_evaluate_a_map_says_what_is_wrong(run_file: Path, two_robots: Path, url: str) -> None:
    for name in ("here", "two"):  # so that there are several
        submaps("replay", str(run_file), "--url", url, "--map", name, "--no-batch")
    for words, says in (
        (("--truth", str(run_file), "--map", "two"), "holds no truth"),
        (("--truth", str(two_robots)), "name a map"),
        ((), "two TUM files"),
        (("a.tum",), "two TUM files"),
        (("a.tum", "b.tum", "--truth", str(two_robots)), "two TUM files"),
    ):
        answer = submaps("evaluate", "--url", url, *words)
        assert answer.returncode == INPUT, answer.stdout + answer.stderr
        assert says in answer.stderr


def test_evaluate_compares_two_trajectories(tmp_path: Path) -> None:
    """The estimate lies 3 m beside a straight truth, and turns by 0.1 rad more each metre."""
    truth, estimate = tmp_path / "truth.tum", tmp_path / "estimate.tum"
    for path, y, turn in ((truth, 0.0, 0.0), (estimate, 3.0, 0.1)):
        angles = 0.5 * turn * np.arange(10)
        lines = [f"{k} {k} {y} 0 0 0 {np.sin(a)!s} {np.cos(a)!s}\n" for k, a in enumerate(angles)]
        path.write_text("".join(lines))
    answer = submaps("evaluate", str(estimate), str(truth), "--no-align", "--unit", "frames", "--delta", "2", "--json")
    assert answer.returncode == 0, answer.stderr
    told = json.loads(answer.stdout)
    assert told["absolute_m"] == {"rmse": 3.0, "mean": 3.0, "median": 3.0, "max": 3.0, "count": 10}
    assert told["relative_rad"]["rmse"] == pytest.approx(0.2)
    assert told["relative_rad"]["count"] == 4
    table = submaps("evaluate", str(estimate), str(truth))
    assert table.returncode == 0
    assert "0.0000 m" in table.stdout  # aligned
    late = submaps("evaluate", str(estimate), str(truth), "--delta", "100")
    assert late.returncode == INPUT
    assert "no two poses lie 100 meters apart" in late.stderr


def test_export_writes_what_other_tools_read(two_on_a_map: dict[str, Any], url: str, tmp_path: Path) -> None:
    words = ("export", "--url", url, "--map", "two")
    assert submaps(*words, "--format", "tum", "--out", str(tmp_path / "way.tum")).returncode == 0
    for robot, part in two_on_a_map["robots"].items():
        track = read_tum(tmp_path / f"way_{robot}.tum")
        assert len(track) == part["steps"]
        alone = submaps(*words, "--format", "tum", "--robot", robot)
        assert alone.stdout == (tmp_path / f"way_{robot}.tum").read_text()
    whole = json.loads(submaps(*words, "--format", "json").stdout)
    assert whole["id"] == "two"
    assert len(whole["landmarks"]) == two_on_a_map["landmarks"]
    assert len(whole["submaps"]) == len(whole["graph"]["nodes"]) == two_on_a_map["submaps"]
    assert len(whole["robots"]) == 2
    lines = submaps(*words, "--format", "g2o").stdout.splitlines()
    assert sum(line.startswith("VERTEX_SE2 ") for line in lines) == two_on_a_map["submaps"]
    assert sum(line.startswith("VERTEX_XY ") for line in lines) == two_on_a_map["landmarks"]


def test_export_says_what_is_wrong(two_on_a_map: dict[str, Any], url: str, tmp_path: Path) -> None:
    words = ("export", "--url", url, "--map", two_on_a_map["map"])
    for more, code, says in (
        (("--format", "tum"), INPUT, "choose one with --robot"),
        (("--format", "g2o", "--robot", "robot1"), INPUT, "--robot chooses a trajectory"),
        (("--format", "g2o", "--out", str(tmp_path / "no" / "map.g2o")), INPUT, "no such folder"),
        (("--format", "g2o", "--out", str(tmp_path)), INPUT, "cannot be written"),
        (("--format", "tum", "--robot", "robot9"), REFUSED, "robot9"),
        (("--format", "toro"), INPUT, "toro"),
    ):
        answer = submaps(*words, *more)
        assert answer.returncode == code, answer.stdout + answer.stderr
        assert says in answer.stderr
