"""``submaps experiment``: runs shared out to workers, the command and its files, every experiment in the registry."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from service.commands import experiment as command
from service.commands.console import INPUT, INTERRUPTED
from service.experiments.base import Experiment, Outcome, Table
from service.experiments.nonodometry_figures import conclude, summarise
from service.experiments.nonodometry_runs import BASE, FILTERS, STARTS, Job, Run, process
from service.experiments.registry import REGISTRY, load
from service.experiments.report import cell
from service.experiments.runner import WorkerLost, Workers
from tests.conftest import ROOT
from tests.tools.experiment_work import multiply, refuse, threads, vanish
from tests.tools.support import submaps

NEEDS_DATA = {"stereo"}  # ../shared/data


# -- workers -------------------------------------------------------------------------------------


def test_results_follow_from_the_seed_and_not_from_the_number_of_workers() -> None:
    found = []
    for count, seed in ((1, 5), (2, 5), (3, 5), (2, 6)):
        with Workers(7, seed, workers=count, quiet=True) as runs:
            found.append(runs.each(multiply, runs.generators(runs.count), "multiplying"))
    assert found[0] == found[1] == found[2]
    assert len(set(found[0])) == 7
    assert not set(found[0]) & set(found[3])


def test_seeds_are_the_same_when_asked_for_again_and_their_children_differ() -> None:
    runs = Workers(3, 11, quiet=True)
    few, more = runs.generators(2), runs.generators(4)
    draws = [np.random.default_rng(seed).integers(1 << 60) for seed in more]
    assert [np.random.default_rng(seed).integers(1 << 60) for seed in few] == draws[:2]
    assert len(set(draws)) == 4


def test_results_keep_the_order_of_the_items_and_workers_have_one_thread() -> None:
    before = os.environ.get("OPENBLAS_NUM_THREADS")
    with Workers(1, 0, workers=2, quiet=True) as runs:
        assert runs.each(refuse, [5, 4, 9, 1], "counting") == [5, 4, 9, 1]
        assert runs.each(threads, [0, 1], "looking") == ["1", "1"]
        assert runs.each(refuse, [], "nothing") == []
    assert os.environ.get("OPENBLAS_NUM_THREADS") == before


def test_a_fault_in_a_worker_ends_the_work_and_says_what_it_was() -> None:
    with pytest.raises(ValueError, match="three"), Workers(1, 0, workers=2, quiet=True) as runs:
        runs.each(refuse, list(range(200)), "counting")


def test_a_worker_that_is_gone_is_told() -> None:
    with pytest.raises(WorkerLost, match="while counting"), Workers(1, 0, workers=1, quiet=True) as runs:
        runs.each(vanish, [1, 2, 3], "counting")


def test_workers_outside_their_block_are_refused() -> None:
    with pytest.raises(RuntimeError, match="with block"):
        Workers(1, 0, quiet=True).each(refuse, [1], "counting")


# -- the command ---------------------------------------------------------------------------------


def test_without_a_name_the_experiments_are_listed() -> None:
    answer = submaps("experiment")
    assert answer.returncode == 0, answer.stderr
    assert all(name in answer.stdout for name in REGISTRY)
    told = json.loads(submaps("experiment", "--list", "--json").stdout)["experiments"]
    assert {one["name"]: one["runs"] for one in told} == {name: load(name).runs for name in REGISTRY}
    assert all(one["about"] for one in told)


def test_a_name_that_is_none_is_told_with_those_that_are() -> None:
    answer = submaps("experiment", "nonsense")
    assert answer.returncode == INPUT
    assert "nonsense" in answer.stderr
    for name in REGISTRY:
        assert name in answer.stderr


@pytest.mark.parametrize("words", [("--runs", "0"), ("--runs", "x"), ("--seed", "-1"), ("--workers", "0")])
def test_wrong_numbers_are_wrong_input(words: tuple[str, ...]) -> None:
    answer = submaps("experiment", "nonodometry", *words)
    assert answer.returncode == INPUT
    assert words[0] in answer.stderr


def test_a_folder_that_cannot_be_is_told_before_the_work(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    answer = submaps("experiment", "nonodometry", "--out", str(tmp_path / "file"))
    assert answer.returncode == INPUT
    assert str(tmp_path / "file") in answer.stderr
    assert "Traceback" not in answer.stderr


@pytest.mark.parametrize("name", sorted(REGISTRY))
def test_every_experiment_has_its_name_and_a_page_with_its_picture(name: str) -> None:
    one, docs = load(name), ROOT / "docs"
    assert one.name == name
    assert one.runs >= 1
    page = (docs / "experiments" / f"{name}.md").read_text()
    assert f"../images/experiments/{name}.png" in page
    assert (docs / "images" / "experiments" / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    assert f"]({name}.md)" in (docs / "experiments" / "README.md").read_text()


@pytest.mark.parametrize("name", sorted(REGISTRY))
def test_every_experiment_runs_once_and_leaves_figures_a_picture_and_a_csv(
    name: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    if name in NEEDS_DATA:
        request.getfixturevalue("data_dir")
    answer = submaps("experiment", name, "--runs", "1", "--seed", "3", "--json", "--out", str(tmp_path / "new"))
    assert answer.returncode == 0, answer.stderr
    told = json.loads(answer.stdout)
    assert (told["experiment"], told["runs"], told["seed"]) == (name, 1, 3)
    assert told["figures"]
    assert told["summary"]
    assert (tmp_path / "new" / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    with (tmp_path / "new" / f"{name}.csv").open(newline="") as lines:
        rows = list(csv.reader(lines))
    assert len(rows) > 1
    assert {len(row) for row in rows} == {len(rows[0])}
    assert set(told["files"]) == {"picture", "csv"}


def test_a_table_says_what_was_assumed_and_where_the_files_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def draw(figure: Figure) -> None:
        figure.add_subplot().plot([1.0, 2.0])

    outcome = Outcome(
        summary="It is [so].",
        table=Table(("what", "much"), (("[one]", 0.123456), ("two", None))),
        figures={"much": 0.123456},
        series=Table(("k", "much"), ((0, 1.0 / 3.0), (1, None))),
        draw=draw,
        assumptions=("That it is [so].",),
    )
    monkeypatch.setitem(REGISTRY, "small", "nowhere")
    monkeypatch.setattr(command, "load", lambda name: Experiment(name, "small", 4, lambda runs: outcome))
    monkeypatch.setenv("COLUMNS", "200")
    command.experiment("small", out=tmp_path)
    said = capsys.readouterr().out
    for part in ("It is [so].", "[one]", "0.1235", "–", "Assumptions", "That it is [so].", str(tmp_path / "small.csv")):
        assert part in said
    assert (tmp_path / "small.csv").read_text().splitlines() == ["k,much", f"0,{1.0 / 3.0!r}", "1,"]
    assert (tmp_path / "small.png").read_bytes().startswith(b"\x89PNG")


def test_json_writes_no_file_unless_told_where(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    outcome = Outcome(
        "So.", Table(("a",), ((1,),)), {"a": np.float64(0.5)}, Table(("a",), ((1,),)), lambda figure: None
    )
    monkeypatch.setitem(REGISTRY, "small", "nowhere")
    monkeypatch.setattr(command, "load", lambda name: Experiment(name, "small", 4, lambda runs: outcome))
    monkeypatch.chdir(tmp_path)
    command.experiment("small", seed=9, json=True)
    told = json.loads(capsys.readouterr().out)
    assert (told["runs"], told["seed"], told["figures"], told["files"]) == (4, 9, {"a": 0.5}, {})
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks for child processes where Linux lists them")
def test_ctrl_c_ends_the_command_and_its_workers() -> None:
    words = [sys.executable, "-m", "service.cli", "experiment", "nonodometry", "--runs", "500", "--json"]
    with subprocess.Popen(
        words, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as child:
        workers: list[str] = []
        while child.poll() is None and len(workers) < 2:  # the tracker of resources is one of them
            time.sleep(0.05)
            workers = Path(f"/proc/{child.pid}/task/{child.pid}/children").read_text().split()
        os.killpg(child.pid, signal.SIGINT)  # as a terminal does
        _, said = child.communicate(timeout=60)
    assert child.returncode == INTERRUPTED
    assert "Traceback" not in said
    deadline = time.monotonic() + 30.0
    while any(map(running, workers)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(map(running, workers))


def running(process_id: str) -> bool:
    """Whether a process is there and not only waits to be fetched by its parent."""
    try:
        return bool(Path(f"/proc/{process_id}/cmdline").read_bytes())
    except OSError:
        return False


# -- what a report says --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "shown"),
    [(None, "–"), (float("nan"), "–"), (True, "yes"), (12345, "12,345"), (np.int64(3), "3"), (0.123456, "0.1235"),
     (np.float64(2e-9), "2e-09"), (float("inf"), "inf"), ("a", "a")],
)  # fmt: skip
def test_cells_are_rounded_where_they_are_shown(value: object, shown: str) -> None:
    assert cell(value) == shown


def test_a_noise_set_is_the_same_whenever_it_is_run() -> None:
    job = Job(0, np.random.SeedSequence(1), "64 views", ("EKF", "UKF linear"), BASE)
    once, again = process(job), process(job)
    assert [replace(one, seconds=0.0) for one in once] == [replace(one, seconds=0.0) for one in again]
    assert all(one.done and one.updates == 136 for one in once)


def test_failures_are_counted_apart_and_do_not_enter_the_medians() -> None:
    def one(name: str, status: str, error: float | None = None) -> Run:
        return Run(0, "4 views", name, BASE, status, 10, 0.01, error, error, error)

    found = [one("EKF", "done", 2.0), one("EKF", "done", 4.0), one("EKF", "no_pose"), one("EKF", "not_positive")]
    (row,) = summarise(found)
    assert (row.runs, row.failed, row.not_positive) == (4, 1, 1)
    assert (row.euclidean, row.mahalanobis, row.milliseconds) == (3.0, 3.0, 1.0)


def test_the_papers_conclusions_follow_from_the_figures() -> None:
    """UKFs at half the EKF's error would contradict the first, a consistent constant pose the second."""

    def told(linear: float, constant: float) -> str:
        errors = {"EKF": 1.0, "UKF constant": 1.0, "UKF linear": linear, "UKF likelihood": 1.0}
        pairs = [(start, name) for start in STARTS for name in FILTERS]
        return conclude(
            summarise([Run(0, *pair, BASE, "done", 10, 0.01, errors[pair[1]], 0.1, constant) for pair in pairs])
        )

    seen, contradicted = told(1.0, 100.0), told(0.5, 1.0)
    assert "not superior to the EKF: reproduced" in seen
    assert "inconsistent: reproduced" in seen
    assert "not superior to the EKF: not reproduced" in contradicted
    assert "inconsistent: not reproduced" in contradicted
