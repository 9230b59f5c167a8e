"""The reader of MRCLAM folders: barcodes, velocities that hold, times that go wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from service.datasets import DatasetError, read_source
from service.datasets.mrclam import SIGMA, SPEED
from submaps.measurements import as_encounter

ORIGIN = 1248446182.0  # times of such size: what is left of them after the origin is exact to the microsecond
FILES = {
    "Barcodes.dat": ["# Subject # Barcode #", "1 5", "2 14", "6 63", "7 25"],
    "Landmark_Groundtruth.dat": ["6 1.5 -2.5 0.001 0.001", "7 3.5 0.5 0.001 0.001"],
    "Robot1_Odometry.dat": ["0.5 0.086 0.1", "0.6 0.086 0.1", "0.7 0.086 0.2", "1.0 0 0", "1.5 0 0", "2.0 0.05 0"],
    "Robot1_Measurement.dat": ["0.65 63 2.5 0.1", "0.9 14 1.5 -0.2", "0.9 25 3.5 0.3", "1.2 63 2.4 0.2"],
    "Robot2_Odometry.dat": ["0.7 0.01 0", "0.9 0.02 0", "0.9 0.03 0", "0.8 0.04 0", "1.4 0.05 0"],
    "Robot2_Measurement.dat": ["0.6 63 1 0", "0.95 99 1 0", "1.0 14 1 0", "1.1 5 1.5 2.9", "1.5 63 1 0"],
    "Robot1_Groundtruth.dat": ["0.5 1 2 0.1", "0.9 1.1 2 0.2"],
}


def shifted(line: str, name: str) -> str:
    """A line with its time put where such files have theirs."""
    if line.startswith("#") or "Barcodes" in name or "Landmark" in name:
        return line
    t, *rest = line.split()
    return " \t".join([f"{ORIGIN + float(t):.3f}", *rest])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    home = tmp_path / "mrclam_0"
    home.mkdir()
    for name, lines in FILES.items():
        (home / name).write_text("# a comment\n" + "".join(f"  {shifted(line, name)} \n" for line in lines))
    return home


def test_a_step_stands_where_the_reading_changes_and_where_something_was_seen(folder: Path) -> None:
    one = read_source(str(folder)).robots["robot1"]
    assert one.t.tolist() == [0.5, 0.65, 0.7, 0.9, 1.0, 1.2, 2.0]


def test_a_reading_holds_until_the_next_and_standing_still_is_no_control(folder: Path) -> None:
    one = read_source(str(folder)).robots["robot1"]
    assert one.control_step.tolist() == [1, 2, 3, 4]
    assert one.control.tolist() == [[0.086] * 4, [0.1, 0.1, 0.2, 0.2]]


def test_barcodes_are_subjects_and_robots_are_met_at_the_time_of_the_step(folder: Path) -> None:
    run = read_source(str(folder))
    one, two = run.robots["robot1"], run.robots["robot2"]
    assert [as_encounter(name) or name for name in one.landmark] == ["6", "7", ("robot2", 0.9), "6"]
    assert one.observation_step.tolist() == [1, 3, 3, 5]
    assert one.z.tolist() == [[2.5, 3.5, 1.5, 2.4], [0.1, 0.3, -0.2, 0.2]]
    assert [as_encounter(name) for name in two.landmark] == [("robot1", 1.1)]
    for batch in (one, two):
        for name, step in zip(batch.landmark, batch.observation_step.tolist(), strict=True):
            met = as_encounter(name)
            assert met is None or met[1] == batch.t[step]


def test_what_goes_wrong_is_mended_and_counted(folder: Path) -> None:
    run = read_source(str(folder))
    assert run.notes == {
        "odometry readings earlier than the one before": 1,
        "odometry readings at the time of another": 1,
        "measurements of an unknown barcode": 1,
        "measurements of the robot's own barcode": 1,
        "measurements before the first odometry": 1,
        "measurements after the last odometry": 1,
    }
    two = run.robots["robot2"]
    assert two.t.tolist() == [0.7, 0.9, 1.1, 1.4]
    assert two.control.tolist() == [[0.01, 0.03, 0.03], [0.0, 0.0, 0.0]]  # the later one of 0.9 s, not that of 0.8 s


def test_the_truth_is_on_the_clock_of_the_measurements(folder: Path) -> None:
    truth = read_source(str(folder)).truth
    assert truth is not None
    assert truth.landmarks["7"].tolist() == [3.5, 0.5]
    assert list(truth.trajectories) == ["robot1"]
    assert truth.trajectories["robot1"].t.tolist() == [0.5, 0.9]
    assert truth.trajectories["robot1"].poses[1].tolist() == [1.1, 2.0, 0.2]


def test_noise_is_a_density_that_goes_with_the_top_speed(folder: Path) -> None:
    slow = read_source(str(folder)).config
    assert slow.motion.noise == "density"
    assert slow.motion.sigma == pytest.approx(SIGMA)
    assert slow.gate == 0.999
    path = folder / "Robot2_Odometry.dat"
    path.write_text(path.read_text().replace(" \t0.05 ", f" \t{3.0 * SPEED} "))
    assert read_source(str(folder)).motion.sigma == pytest.approx(tuple(3.0 * sigma for sigma in SIGMA))


@pytest.mark.parametrize(
    ("name", "line", "says"),
    [
        ("Robot1_Odometry.dat", "1.0 2.0", r"Robot1_Odometry\.dat:8: expected 3 finite numbers, got '1\.0 2\.0'"),
        ("Robot2_Measurement.dat", "1.0 5 nan 1", r"Robot2_Measurement\.dat:7: expected 4 finite numbers"),
        ("Robot2_Measurement.dat", "1248446183.0 5 -1 1", "expected ranges above 0, got -1"),
        ("Barcodes.dat", "x y", r"Barcodes\.dat:7: expected 2 finite numbers, got 'x y'"),
    ],
)
def test_a_broken_line_is_named(folder: Path, name: str, line: str, says: str) -> None:
    with (folder / name).open("a") as out:
        out.write(line + "\n")
    with pytest.raises(DatasetError, match=says):
        read_source(str(folder))


def test_a_folder_without_what_is_needed(folder: Path) -> None:
    (folder / "Robot1_Measurement.dat").unlink()
    with pytest.raises(DatasetError, match=r"Robot1_Measurement\.dat: cannot be read"):
        read_source(str(folder))
    for path in folder.glob("Robot*"):
        path.unlink()
    with pytest.raises(DatasetError, match="expected a file Robot1_Odometry"):
        read_source(str(folder))


def test_without_truth_there_is_none(folder: Path) -> None:
    (folder / "Robot1_Groundtruth.dat").unlink()
    truth = read_source(str(folder)).truth
    assert truth is not None
    assert not truth.trajectories
    (folder / "Landmark_Groundtruth.dat").unlink()
    assert read_source(str(folder)).truth is None


def test_the_real_folders_hold_what_is_known_of_them(data_dir: Path) -> None:
    seven, nine = (read_source(str(data_dir / f"mrclam_{k}")) for k in (7, 9))
    assert seven.notes == {
        "odometry readings at the time of another": 29,
        "measurements of an unknown barcode": 9,
    }
    assert nine.notes == {
        "odometry readings earlier than the one before": 4,
        "measurements of an unknown barcode": 2,
    }
    assert seven.observations + 9 == 20_282
    met = [name for batch in seven.robots.values() for name in batch.landmark if as_encounter(name)]
    assert len(met) == 4_206
    assert seven.truth is not None
    assert nine.truth is not None
    assert len(seven.truth.landmarks) == 15
    assert len(seven.truth.trajectories) == 5
    assert not nine.truth.trajectories
    for run in (seven, nine):
        for batch in run.robots.values():
            assert np.all(np.diff(batch.t) > 0.0)
            assert np.all(np.diff(batch.observation_step) >= 0)


def test_robots_stand_where_vicon_says_so(data_dir: Path) -> None:
    """Over steps without a control, apart by a second and more, Vicon sees less than a centimetre of motion."""
    run = read_source(str(data_dir / "mrclam_7"))
    assert run.truth is not None
    moved = []
    for robot, batch in run.robots.items():
        still = np.setdiff1d(np.arange(1, batch.steps), batch.control_step)
        long = still[batch.t[still] - batch.t[still - 1] > 1.0]
        for k in long.tolist():
            track, known = run.truth.trajectories[robot].at(batch.t[k - 1 : k + 1] + np.array([0.5, 0.0]), 0.5)
            if known.all():
                moved.append(float(np.hypot(*np.diff(track.poses[:, :2], axis=0)[0])))
    assert len(moved) > 5
    assert max(moved) < 0.01
