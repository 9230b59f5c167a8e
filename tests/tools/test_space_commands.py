"""Starry Night through the commands: replayed over HTTP, held against Vicon, drawn and written."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from service.commands.console import INPUT
from service.datasets import read_source
from service.wire.poses import tum_rest
from submaps.geometry.space import SOLID
from tests.service.support import Json
from tests.tools.support import submaps


@pytest.fixture(scope="module")
def folder(data_dir: Path) -> str:
    return str(data_dir / "starry_night")


@pytest.fixture(scope="module")
def replayed(folder: str, url: str, tmp_path_factory: pytest.TempPathFactory) -> Json:
    """What the replay with odometry tells; its map is ``night``."""
    picture = tmp_path_factory.mktemp("night") / "night.png"
    answer = submaps("replay", folder, "--url", url, "--map", "night", "--json", "--plot", str(picture))
    assert answer.returncode == 0, answer.stderr
    assert picture.read_bytes().startswith(b"\x89PNG")
    told: Json = json.loads(answer.stdout)
    return told


def test_landmarks_lie_within_millimetres_of_vicon(replayed: Json) -> None:
    assert (replayed["steps"], replayed["landmarks"]) == (1900, 20)
    assert replayed["robots"]["robot"]["rejected"] == {}
    assert replayed["landmark_rmse_to_truth"] < 0.005
    assert replayed["robots"]["robot"]["absolute_trajectory_rmse"] < 0.05


def test_the_batch_optimum_is_no_nearer_to_vicon_by_more_than_a_tenth(replayed: Json) -> None:
    assert replayed["landmark_rmse_to_truth"] < 1.1 * replayed["batch_landmark_rmse_to_truth"]
    assert replayed["landmark_rmse"] < 0.005


def test_without_odometry_too(folder: str, url: str) -> None:
    answer = submaps("replay", folder, "--without-odometry", "--no-batch", "--url", url, "--map", "dark", "--json")
    assert answer.returncode == 0, answer.stderr
    told = json.loads(answer.stdout)
    assert (told["steps"], told["landmarks"], sum(told["notes"].values())) == (1220, 20, 680)
    assert told["landmark_rmse_to_truth"] < 0.006


def test_a_run_in_the_plane_needs_its_odometry(run_file: Path) -> None:
    answer = submaps("replay", str(run_file), "--without-odometry")
    assert answer.returncode == INPUT
    assert "can do without odometry" in answer.stderr


def test_a_map_in_space_is_evaluated(replayed: Json, folder: str, url: str) -> None:
    words = ("evaluate", "--truth", folder, "--url", url, "--map", "night")
    answer = submaps(*words, "--json")
    assert answer.returncode == 0, answer.stderr
    told = json.loads(answer.stdout)
    assert set(told["alignment"]) == {"x", "y", "z", "quaternion"}
    assert told["landmarks_m"]["rmse"] == pytest.approx(replayed["landmark_rmse_to_truth"])
    ate = replayed["robots"]["robot"]["absolute_trajectory_rmse"]
    assert told["robots"]["robot"]["absolute"]["rmse"] == pytest.approx(ate)
    assert 0.0 < told["pose_nees"] < 3.0
    shown = submaps(*words).stdout
    assert "their NEES by 3n - 6 (alignment takes 6)" in shown
    assert "rotation" in shown


def test_its_trajectory_as_tum_has_the_same_error(replayed: Json, folder: str, url: str, tmp_path: Path) -> None:
    out, true = tmp_path / "night.tum", tmp_path / "vicon.tum"
    assert submaps("export", "--format", "tum", "--url", url, "--map", "night", "--out", str(out)).returncode == 0
    known = read_source(folder).truth
    assert known is not None
    track = known.trajectories["robot"]
    rows = zip(track.t.tolist(), track.poses, strict=True)
    true.write_text("".join(f"{t!r} {tum_rest(SOLID.as_pose(row))}\n" for t, row in rows))
    answer = submaps("evaluate", str(out), str(true), "--space", "se3", "--json")
    assert answer.returncode == 0, answer.stderr
    ate = replayed["robots"]["robot"]["absolute_trajectory_rmse"]
    # Of a whole map the few poses are left out around which Vicon's lie more than half a second apart.
    assert json.loads(answer.stdout)["absolute_m"]["rmse"] == pytest.approx(ate, rel=0.01)


def test_it_is_written_as_g2o(replayed: Json, url: str, tmp_path: Path) -> None:
    out = tmp_path / "night.g2o"
    assert submaps("export", "--format", "g2o", "--url", url, "--map", "night", "--out", str(out)).returncode == 0
    lines = [line.split() for line in out.read_text().splitlines()]
    counts = {tag: sum(line[0] == tag for line in lines) for tag in {line[0] for line in lines}}
    assert counts["VERTEX_SE3:QUAT"] == replayed["submaps"]
    assert counts["EDGE_SE3:QUAT"] == replayed["submaps"] - 1
    assert counts["VERTEX_TRACKXYZ"] == 20
    for line in lines:
        if line[0] == "EDGE_SE3:QUAT":
            information = np.zeros((6, 6))
            information[np.triu_indices(6)] = [float(word) for word in line[10:]]
            assert np.linalg.eigvalsh(information, UPLO="U")[0] > 0.0
