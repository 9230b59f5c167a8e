"""The command ``submaps`` as its users run it: a process, its words, its exit code."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import httpx
import numpy as np
import pytest

from service.commands.console import FAULT, INPUT, REFUSED, UNREACHABLE
from service.datasets.tum import read_tum
from service.standalone import LISTENING, own_service
from submaps.config import ObservationConfig
from tests.tools.fleet import drive, write_mrclam

STEPS = 40


def submaps(*words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "service.cli", *words],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=180,
        check=False,
        env={**os.environ, "COLUMNS": "120", **environment},
    )


@pytest.fixture(scope="module")
def run_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twice round a circle of 20 steps past twelve trees."""
    random = np.random.default_rng(5)
    trees = 9.0 * np.exp(2j * np.pi * np.arange(12) / 12) + 6j
    turn = 2 * np.pi / 20
    lines, at, heading = [], 0j, 0.0
    for k in range(STEPS):
        if k:
            dx, dy, dtheta = np.array([2.0, 0.0, turn]) + random.normal(size=3) * (0.02, 0.02, 0.01)
            at, heading = at + 2.0 * np.exp(1j * heading), heading + turn
            lines.append(f"ODOMETRY {k - 1} {k} {dx} {dy} {dtheta} 50 0 0 50 0 100")
        seen = (trees - at) * np.exp(-1j * heading)
        for j in np.flatnonzero(abs(seen) < 8.0):
            x, y = np.array([seen[j].real, seen[j].imag]) + 0.1 * random.normal(size=2)
            lines.append(f"LANDMARK {k} {j} {x} {y} 10 0 10")
    path = tmp_path_factory.mktemp("runs") / "Two Rounds.txt"
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    with own_service() as address:
        yield address


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        port: int = one.getsockname()[1]
        return port


def test_help_names_the_commands_and_the_exit_codes() -> None:
    answer = submaps("--help")
    assert answer.returncode == 0
    for word in ("serve", "replay", "plot", "export", "evaluate", "Exit codes"):
        assert word in answer.stdout


@pytest.mark.parametrize("words", [("nonsense",), ("replay",), ("serve", "--port", "x")])
def test_wrong_words_are_wrong_input(words: tuple[str, ...]) -> None:
    assert submaps(*words).returncode == INPUT


def test_replay_starts_a_service_of_its_own_and_tells_what_came_out(run_file: Path, tmp_path: Path) -> None:
    picture = tmp_path / "map.png"
    answer = submaps("replay", str(run_file), "--json", "--plot", str(picture))
    assert answer.returncode == 0, answer.stderr
    told = json.loads(answer.stdout)
    assert told["map"] == "two-rounds"
    assert told["steps"] == STEPS
    assert told["landmarks"] == 12
    assert told["submaps"] >= 1
    assert told["microseconds_per_observation"] > 0.0
    assert told["landmark_rmse"] < 0.05
    assert told["landmark_rmse"] <= told["landmark_rmse_unaligned"]
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_replay_to_a_running_service_prints_a_table_and_the_map_stays(run_file: Path, url: str) -> None:
    answer = submaps("replay", str(run_file), "--url", url, "--map", "here")
    assert answer.returncode == 0, answer.stderr
    for label in ("steps", "landmarks", "sub-maps", "µs", "landmark RMSE"):
        assert label in answer.stdout
    assert httpx.get(f"{url}/v1/maps/here").json()["counts"]["steps"] == STEPS


def test_no_batch_leaves_the_comparison_out(run_file: Path, url: str) -> None:
    answer = submaps("replay", str(run_file), "--url", url, "--map", "quick", "--no-batch", "--json")
    assert answer.returncode == 0, answer.stderr
    assert "landmark_rmse" not in json.loads(answer.stdout)


def test_a_name_that_is_taken_is_refused_with_what_to_do(run_file: Path, url: str) -> None:
    words = ("replay", str(run_file), "--url", url, "--map", "taken", "--no-batch")
    assert submaps(*words).returncode == 0
    answer = submaps(*words)
    assert answer.returncode == REFUSED
    assert "--map" in answer.stderr


def test_a_name_that_no_map_can_have_is_refused_by_the_service(run_file: Path, url: str) -> None:
    answer = submaps("replay", str(run_file), "--url", url, "--map", "No Such")
    assert answer.returncode == REFUSED
    assert "id" in answer.stderr


def test_plot_draws_a_map_of_a_running_service(run_file: Path, url: str, tmp_path: Path) -> None:
    assert submaps("replay", str(run_file), "--url", url, "--map", "drawn", "--no-batch").returncode == 0
    for suffix, magic in ((".png", b"\x89PNG"), (".svg", b"<?xml")):
        out = tmp_path / f"map{suffix}"
        answer = submaps("plot", "--url", url, "--map", "drawn", "--out", str(out))
        assert answer.returncode == 0, answer.stderr
        assert out.read_bytes().startswith(magic)


def test_plot_of_no_such_map_and_of_nothing_to_draw_into(url: str, tmp_path: Path) -> None:
    answer = submaps("plot", "--url", url, "--map", "none", "--out", str(tmp_path / "map.png"))
    assert answer.returncode == REFUSED
    assert "none" in answer.stderr
    answer = submaps("plot", "--url", url, "--out", str(tmp_path / "map.doc"))
    assert answer.returncode == INPUT
    assert ".png" in answer.stderr
    answer = submaps("plot", "--url", url, "--out", str(tmp_path / "no" / "map.png"))
    assert answer.returncode == INPUT
    assert "no such folder" in answer.stderr


# -- several robots, and the truth ---------------------------------------------------------------


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


@pytest.mark.parametrize("command", ["replay", "plot", "export"])
def test_where_nothing_answers_it_says_how_to_start_a_service(command: str, run_file: Path) -> None:
    source = {"replay": [str(run_file)], "export": ["--format", "json"]}.get(command, [])
    answer = submaps(command, *source, "--url", f"http://127.0.0.1:{free_port()}")
    assert answer.returncode == UNREACHABLE
    assert "submaps serve" in answer.stderr


def test_what_is_no_address_is_told(run_file: Path) -> None:
    answer = submaps("replay", str(run_file), "--url", "127.0.0.1:8080")
    assert answer.returncode == UNREACHABLE
    assert "http://127.0.0.1:8080" in answer.stderr


def test_another_kind_of_server_is_recognised(run_file: Path) -> None:
    class Other(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            self.send_error(501)

        def log_message(self, format: str, *args: object) -> None:
            pass

    with HTTPServer(("127.0.0.1", 0), Other) as server:
        Thread(target=server.handle_request, daemon=True).start()
        answer = submaps("replay", str(run_file), "--url", f"http://127.0.0.1:{server.server_port}")
    assert answer.returncode == REFUSED
    assert "not by a Submaps service" in answer.stderr


def test_a_missing_file_and_a_broken_line_are_named(tmp_path: Path) -> None:
    answer = submaps("replay", str(tmp_path / "none.txt"))
    assert answer.returncode == INPUT
    assert "no such file" in answer.stderr
    broken = tmp_path / "broken.txt"
    broken.write_text("ODOMETRY 0 1 1 0 0 1 0 0 1 0 1\nLANDMARK 1 4 1 x 1 0 1\n")
    answer = submaps("replay", str(broken))
    assert answer.returncode == INPUT
    assert f"{broken}:2: expected a finite number, got 'x'" in answer.stderr


def test_serve_says_where_it_listens_and_ends_on_a_signal(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "service.cli", "serve", "--port", "0", "--data", str(tmp_path / "data")]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        line = child.stdout.readline()
        try:
            assert line.startswith(f"{LISTENING}http://127.0.0.1:")
            assert httpx.get(line.removeprefix(LISTENING).split()[0] + "/healthz").status_code == 200
        finally:
            child.send_signal(signal.SIGINT)
            _, said = child.communicate(timeout=30)
    assert "Traceback" not in said
    assert child.returncode in (0, 130)


def test_serve_on_a_port_in_use_says_so(url: str, tmp_path: Path) -> None:
    port = url.rsplit(":", 1)[1]
    answer = submaps("serve", "--port", port, "--data", str(tmp_path))
    assert answer.returncode == INPUT
    assert "--port" in answer.stderr


def test_serve_where_the_data_cannot_be(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    answer = submaps("serve", "--port", "0", "--data", str(tmp_path / "file"))
    assert answer.returncode == INPUT
    assert "Traceback" not in answer.stderr
    assert submaps("serve", "--port", "70000").returncode == INPUT


def test_a_service_that_cannot_start_is_a_fault_with_its_last_words(run_file: Path) -> None:
    answer = submaps("replay", str(run_file), SUBMAPS_MAX_BODY_BYTES="none")
    assert answer.returncode == FAULT
    assert "max_body_bytes" in answer.stderr
