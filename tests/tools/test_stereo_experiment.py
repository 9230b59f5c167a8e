"""Starry Night against Vicon: joined sub-maps are as good as the batch solution."""

from __future__ import annotations

from pathlib import Path

import pytest

from service.datasets.dataset import DatasetError
from service.experiments.stereo import BATCH, JOINED, LIMIT, ONE_CAMERA, Task, estimate, folder


@pytest.mark.parametrize("odometry", [True, False], ids=["with odometry", "without"])
def test_joined_sub_maps_are_as_near_to_vicon_as_the_batch(data_dir: Path, odometry: bool) -> None:
    joined = estimate(Task(data_dir / "starry_night", JOINED, odometry))
    batch = estimate(Task(data_dir / "starry_night", BATCH, odometry))
    assert joined.submaps > 20
    assert len(joined.landmarks) == 20
    assert joined.landmark_rmse < 0.006
    assert joined.landmark_rmse <= LIMIT * batch.landmark_rmse
    assert joined.trajectory_rmse < 0.05


def test_one_camera_maps_too(data_dir: Path) -> None:
    told = estimate(Task(data_dir / "starry_night", ONE_CAMERA, True))
    assert told.landmark_rmse < 0.12
    assert told.nees is not None
    assert told.nees < 3.0


def test_a_folder_without_the_run_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SUBMAPS_DATA", str(tmp_path))
    with pytest.raises(DatasetError, match="SUBMAPS_DATA"):
        folder()
