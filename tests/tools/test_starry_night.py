"""The reader of Starry Night: frames, noise and what it does without odometry, against the data's own truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from service.datasets import Dataset, DatasetError, read_source
from service.datasets.dataset import cut
from service.datasets.starry_night import UNSEEN, increments, read_starry_night
from submaps.geometry.so3 import rotation_vector
from submaps.geometry.space import SOLID, Pose

Floats = NDArray[np.float64]

# Looks down: z of the camera is -z of the vehicle.
FILES = {
    "calib.txt": [
        "fu 400", "fv 410", "cu 320", "cv 240", "b 0.25", "w_var 0.01 0.02 0.03", "v_var 0.001 0.002 0.003",
        "y_var 4 9 4 9", "rho_v_c_v 0.1 0.2 0.3", "C_c_v 1 0 0 0 -1 0 0 0 -1",
    ],
    "imu.csv": ["0.0,1,0,0,0,0,0", "0.5,1,0,0,0,0,3.14159265358979", "1.0,0,0,0,0,0,0", "1.5,0,0,1,0,0,0"],
    "stereo.csv": [f"{t},{mark},1,2,3,4" for t, marks in ((0.0, "579"), (1.0, "57"), (1.5, "579")) for mark in marks],
    "landmarks.csv": ["5,1,2,3", "7,4,5,6"],
    "groundtruth.csv": ["0.0,0,0,0,0,0,0", "0.5,0.5,0,0,0,0,0", "1.0,1,0,0,0,0,1"],
}  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    home = tmp_path / "night"
    home.mkdir()
    for name, lines in FILES.items():
        (home / name).write_text("\n".join([*(["# a comment"] if name.endswith("csv") else []), *lines]) + "\n")
    return home


def test_a_reading_holds_until_the_next_and_moves_along_a_screw(folder: Path) -> None:
    """Straight for 0.5 s, then half a turn in 1 s seen half: an arc of radius 1/pi through a right angle."""
    run = read_source(str(folder))
    control = run.columns.control
    np.testing.assert_allclose(control[:, 0], [0.5, 0.0, 0.0, 0.0, 0.0, 0.0], atol=1e-15)
    radius = 1.0 / np.pi
    np.testing.assert_allclose(control[:, 1], [radius, radius, 0.0, 0.0, 0.0, np.pi / 2], atol=1e-9)
    assert run.columns.control_step.tolist() == [1, 2, 3]
    assert run.columns.t.tolist() == [0.0, 0.5, 1.0, 1.5]


def test_noise_is_that_of_a_reading(folder: Path) -> None:
    run = read_source(str(folder))
    assert run.columns.control_covariance is not None
    np.testing.assert_allclose(
        np.diagonal(run.columns.control_covariance[2]), 0.25 * np.array([0.001, 0.002, 0.003, 0.01, 0.02, 0.03])
    )
    assert run.observation.sigma == (2.0, 3.0, 2.0, 3.0)
    assert run.motion.sigma == pytest.approx(0.5 * np.sqrt([0.001, 0.002, 0.003, 0.01, 0.02, 0.03]))


def test_an_increments_covariance_follows_its_reading() -> None:
    """Against samples of the reading, 0.4 rad about any axis: what the first order leaves out is small."""
    random = np.random.default_rng(3)
    v_var, w_var = np.array([1e-4, 2e-4, 3e-4]), np.array([4e-4, 1e-3, 2e-3])
    twist, dt = np.array([0.8, -0.5, 0.3, 0.5, -0.6, 0.4]), 0.5
    _, covariance = increments(np.array([[0.0, *twist], [dt, *twist]]), v_var, w_var)
    samples = np.empty((20_000, 6))
    for row, noise in zip(samples, random.normal(size=samples.shape), strict=True):
        held = twist + noise * np.sqrt([*v_var, *w_var])
        row[:3], row[3:] = SOLID.left_jacobian(dt * held[3:]) @ held[:3] * dt, dt * held[3:]
    scale = np.sqrt(np.diagonal(covariance[0]))
    np.testing.assert_allclose(
        np.cov(samples.T) / np.outer(scale, scale), covariance[0] / np.outer(scale, scale), atol=0.1
    )


def test_the_mount_is_the_cameras_pose_in_the_vehicle(folder: Path) -> None:
    camera = read_source(str(folder)).observation
    assert camera.mount[:3] == (0.1, 0.2, 0.3)
    assert [abs(value) for value in camera.mount[3:]] == [1.0, 0.0, 0.0, 0.0]
    assert camera.camera is not None
    assert (camera.camera.fu, camera.camera.fv, camera.camera.baseline) == (400.0, 410.0, 0.25)


def test_without_odometry_a_step_needs_three_readings(folder: Path) -> None:
    run = read_source(str(folder), odometry=False)
    assert run.motion.model == "none"
    assert run.notes == {UNSEEN: 2}
    assert run.columns.t.tolist() == [0.0, 1.5]
    assert run.columns.control.shape == (0, 0)
    assert run.columns.observation_step.tolist() == [0, 0, 0, 1, 1, 1]
    assert run.columns.landmark == ("5", "7", "9") * 2
    part = cut(run.columns, 1, 2)
    assert (part.control.shape, part.z.shape) == ((0, 0), (4, 3))


def test_other_data_sets_cannot_do_without_odometry(folder: Path, data_dir: Path) -> None:
    for source in (str(data_dir / "mrclam_7"), str(data_dir / "isam" / "victoriaPark.txt"), "victoria-park"):
        with pytest.raises(DatasetError, match="can do without odometry"):
            read_source(source, odometry=False)


@pytest.mark.parametrize(
    ("name", "line", "says"),
    [
        ("calib.txt", "fu 1 2", r"calib\.txt:11: fu takes 1 numbers, got 2"),
        ("calib.txt", "b zero", r"calib\.txt:11: expected a finite number, got 'zero'"),
        ("imu.csv", "1.6,1,2", r"imu\.csv:6: expected 7 finite numbers, got '1\.6,1,2'"),
        ("imu.csv", "1.5,0,0,0,0,0,0", r"imu\.csv: expected two lines or more whose times rise"),
        ("stereo.csv", "1.2,5,1,2,3,4", r"stereo\.csv: expected times of imu\.csv, got 1\.2"),
        ("stereo.csv", "1.5,5,1,2,3,nan", r"stereo\.csv:10: expected 6 finite numbers"),
    ],
)
def test_a_broken_line_is_named(folder: Path, name: str, line: str, says: str) -> None:
    with (folder / name).open("a") as out:
        out.write(line + "\n")
    with pytest.raises(DatasetError, match=says):
        read_source(str(folder))


def test_what_is_missing_is_named(folder: Path) -> None:
    lines = (folder / "calib.txt").read_text().splitlines()
    (folder / "calib.txt").write_text("\n".join(line for line in lines if not line.startswith(("cv", "b "))))
    with pytest.raises(DatasetError, match="expected lines for cv, b too"):
        read_source(str(folder))
    (folder / "groundtruth.csv").unlink()
    (folder / "calib.txt").write_text("\n".join(lines))
    assert read_source(str(folder)).truth is None


# -- the data ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def run(data_dir: Path) -> Dataset:
    return read_starry_night(data_dir / "starry_night")


def test_the_folder_holds_what_is_known_of_it(run: Dataset) -> None:
    assert (run.steps, run.observations, len(set(run.columns.landmark))) == (1900, 9410, 20)
    assert run.truth is not None
    assert len(run.truth.landmarks) == 20


def pose_of(row: Floats) -> Pose:
    return tuple(row.tolist())


def test_the_truth_predicts_the_readings_with_the_calibrations_variances(run: Dataset) -> None:
    """p = C_cv (C_vi (l - r) - rho), u = fu x/z + cu: residuals have the variances of calib.txt, to 1 %."""
    assert run.truth is not None
    camera, batch, track = run.observation.camera, run.columns, run.truth.trajectories["robot"]
    assert camera is not None
    x, y, z, *q = run.observation.mount
    mount = (x, y, z, *rotation_vector((q[0], q[1], q[2], q[3])))
    residual = np.empty((batch.observations, 4))
    for k, (step, mark) in enumerate(zip(batch.observation_step.tolist(), batch.landmark, strict=True)):
        sensor = SOLID.inverse(SOLID.compose(pose_of(track.poses[step]), mount))
        px, py, pz = SOLID.transform(sensor, run.truth.landmarks[mark])
        u, v = camera.fu * px / pz + camera.cu, camera.fv * py / pz + camera.cv
        residual[k] = batch.z[:, k] - (u, v, u - camera.fu * camera.baseline / pz, v)
    np.testing.assert_allclose(residual.var(axis=0), np.square(run.observation.sigma), rtol=0.01)
    assert np.abs(residual.mean(axis=0)).max() < 2.0


def test_the_truth_moves_as_the_readings_say_with_the_calibrations_variances(run: Dataset) -> None:
    """Errors of the increments over their own sigma have the variance 1: ``w_var``, ``v_var`` are of a reading."""
    assert run.truth is not None
    poses, covariance = run.truth.trajectories["robot"].poses, run.columns.control_covariance
    assert covariance is not None
    error = np.empty((len(poses) - 1, 6))
    for k, said in enumerate(run.columns.control.T):
        moved = SOLID.between(pose_of(poses[k]), pose_of(poses[k + 1]))
        error[k] = np.subtract(moved, said)
        error[k, 3:] = SOLID.between((0.0, 0.0, 0.0, *said[3:]), (0.0, 0.0, 0.0, *moved[3:]))[3:]
    share = error / np.sqrt(np.einsum("nii->ni", covariance))
    np.testing.assert_allclose(share.var(axis=0), np.ones(6), atol=0.06)


def test_turned_the_other_way_round_the_truth_would_predict_nothing(run: Dataset) -> None:
    """With phi negated, markers would lie behind the camera."""
    assert run.truth is not None
    poses = run.truth.trajectories["robot"].poses.copy()
    poses[:, 3:] *= -1.0
    x, y, z, *q = run.observation.mount
    mount = (x, y, z, *rotation_vector((q[0], q[1], q[2], q[3])))
    sensor = [SOLID.inverse(SOLID.compose(pose_of(row), mount)) for row in poses[run.columns.observation_step]]
    depths = [
        SOLID.transform(at, run.truth.landmarks[mark])[2] for at, mark in zip(sensor, run.columns.landmark, strict=True)
    ]
    assert min(depths) < 0.0
