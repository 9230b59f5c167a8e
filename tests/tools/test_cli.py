"""The command ``submaps`` as its users run it: a process, its words, its exit code."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from threading import Thread

import httpx
import pytest

from service.commands.console import FAULT, INPUT, REFUSED, UNREACHABLE
from service.standalone import LISTENING
from tests.tools.support import STEPS, submaps


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
