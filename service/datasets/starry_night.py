"""Reader of the Starry Night data set, a folder: a stereo camera and an inertial unit above reflective markers.

A rig of a camera pair and an inertial unit was moved by hand through a room, looking down at markers on
the floor; Vicon watched both (T. D. Barfoot, "State Estimation for Robotics", Cambridge University Press
2017, whose symbols and dataset these are)::

    calib.txt        fu fv cu cv b, w_var v_var y_var, rho_v_c_v and C_c_v: a name and its numbers a line
    imu.csv          t_s, vx, vy, vz, wx, wy, wz           of the vehicle, in its own frame; m/s, rad/s
    stereo.csv       t_s, landmark_id, u_left, v_left, u_right, v_right      px; at times of imu.csv
    landmarks.csv    landmark_id, x, y, z                  Vicon, m
    groundtruth.csv  t_s, x, y, z, phi_x, phi_y, phi_z     Vicon: r_i_vi, and the axis-angle of C_vi

**Frames.** A point l of the room is at p = C_cv (C_vi (l - r) - rho) in the left camera, so that the sensor's
pose in the vehicle is (rho, C_cvᵀ). C_vi = exp(-S(phi)) takes the room's coordinates to the vehicle's: phi is
the rotation vector of the vehicle's pose. With that the readings which the truth predicts are off by
variances of 37.98, 129.82, 41.95 and 132.48 px², those of ``y_var``; with phi negated, by thousands of pixels.

**Steps.** The reading of imu.csv at a step holds until the next one, a twist held for dt: r = w dt, d = V(r) v dt
(exact on SE(3)). ``w_var`` and ``v_var`` are those of a reading, not densities: against Vicon, the increments
divided by dt (0.046 to 0.73 s, 0.063 s at the median) are off by 0.00904, 0.0170 and 0.1746 rad²/s² about the
axes and by 0.00262, 0.00208 and 0.00075 m²/s² along them, which are the file's numbers to 6 %. A density would have
the errors in the position four times as large. Each increment carries its own covariance, as dt varies.

**What no model here knows.** The errors are not white. Those of the pixels last (successive ones of a landmark
correlate by 0.73 to 0.93), and both images share them: the disparity's variance is 11 px², an eighth of what
independent pixels would have. Over half a second and more the increments are better than the file says, but for
the vertical, and they are no worse over 0.7 s than over 0.05 s. Expect covariances that are too large in depth,
too small after long.

**Sub-maps** end at a rotation of 0.05 rad: the 0.01 rad that serve a good odometer would end one wherever they may,
with every fifth step that sees something. The landmarks are as good by either.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from service.datasets.dataset import ROBOT, Dataset, DatasetError, Truth
from service.datasets.lines import BadLine, finite, opened, table
from submaps.config import Camera, MapConfig, MotionConfig, ObservationConfig
from submaps.geometry import so3
from submaps.geometry.space import SOLID
from submaps.measurements import Batch
from submaps.trajectory import Trajectory

Floats = NDArray[np.float64]

CALIBRATION, STEREO = "calib.txt", "stereo.csv"
MAX_HEADING_SIGMA = 0.05  # rad
UNSEEN = "steps with fewer than three readings, of which no pose follows without odometry"
LEAST_READINGS = 3
_FIELDS = {
    "fu": 1, "fv": 1, "cu": 1, "cv": 1, "b": 1, "w_var": 3, "v_var": 3, "y_var": 4, "rho_v_c_v": 3, "C_c_v": 9,
}  # fmt: skip
_SAME_TIME = 1e-6  # s


def is_starry_night(path: Path) -> bool:
    """Whether a path is such a folder."""
    return (path / CALIBRATION).is_file() and (path / STEREO).is_file()


def read_starry_night(folder: Path, *, odometry: bool = True) -> Dataset:
    """Read one folder, with its odometry or as a map without motion.

    Raises ``DatasetError``, naming the file and the line, where it is not as expected.
    """
    calibration = _calibration(folder / CALIBRATION)
    readings = _timed(folder / "imu.csv")
    step, landmark, z = _stereo(folder / STEREO, readings[:, 0])
    covariance, notes = None, {}
    if odometry:
        control, covariance = increments(readings, calibration["v_var"], calibration["w_var"])
        dt = float(np.median(np.diff(readings[:, 0])))
        sigma = np.sqrt(np.concatenate([calibration["v_var"], calibration["w_var"]])) * dt
        motion = MotionConfig("odometry3d", tuple(sigma.tolist()))
        t, control_step = readings[:, 0], np.arange(1, len(readings), dtype=np.int64)
    else:
        motion = MotionConfig("none", ())
        counts = np.bincount(step, minlength=len(readings))
        kept = counts[step] >= LEAST_READINGS
        seen, step = np.unique(step[kept], return_inverse=True)
        landmark = tuple(itertools.compress(landmark, kept))
        t, z, control_step, control = readings[seen, 0], z[:, kept], np.empty(0, np.int64), np.empty((0, 0))
        notes[UNSEEN] = len(readings) - len(seen)
    batch = Batch(
        t=np.ascontiguousarray(t),
        control_step=control_step,
        control=control,
        control_covariance=covariance,
        observation_step=step.astype(np.int64),
        landmark=landmark,
        z=np.ascontiguousarray(z),
        observation_covariance=None,
    )
    config = MapConfig(motion, _camera(calibration), max_heading_sigma=MAX_HEADING_SIGMA, space="se3")
    return Dataset(folder.resolve().name, config, {ROBOT: batch}, _truth(folder), notes)


def increments(readings: Floats, v_var: Floats, w_var: Floats) -> tuple[Floats, Floats]:
    """Increments (6, n - 1) of readings (n, 7) held from one time to the next, and their covariances (n - 1, 6, 6).

    r = w dt, d = V(r) v dt; to first order in r the error of d is dt V e_v - dt²/2 S(v) e_w, that of r dt e_w.
    """
    dt = np.diff(readings[:, 0])
    v, w = readings[:-1, 1:4], readings[:-1, 4:]
    control = np.empty((6, len(dt)))
    slope = np.zeros((len(dt), 6, 6))
    for k, (velocity, turn) in enumerate(zip(v, w * dt[:, np.newaxis], strict=True)):
        V = SOLID.left_jacobian(turn)
        control[:3, k], control[3:, k] = dt[k] * V @ velocity, turn
        slope[k, :3, :3], slope[k, :3, 3:], slope[k, 3:, 3:] = V, 0.5 * dt[k] * SOLID.turn(velocity), np.eye(3)
    slope *= dt[:, np.newaxis, np.newaxis]
    covariance = slope * np.concatenate([v_var, w_var]) @ slope.transpose(0, 2, 1)
    return control, 0.5 * (covariance + covariance.transpose(0, 2, 1))


# -- files ---------------------------------------------------------------------------------------


def _calibration(path: Path) -> dict[str, Floats]:
    found: dict[str, Floats] = {}
    with opened(path) as lines:
        for number, line in enumerate(lines, start=1):
            name, *values = line.split() or ("",)
            if name not in _FIELDS:
                continue
            try:
                found[name] = np.array(finite(values))
            except BadLine as error:
                raise DatasetError(f"{path}:{number}: {error}") from None
            if len(values) != _FIELDS[name]:
                raise DatasetError(f"{path}:{number}: {name} takes {_FIELDS[name]} numbers, got {len(values)}")
    missing = [name for name in _FIELDS if name not in found]
    if missing:
        raise DatasetError(f"{path}: expected lines for {', '.join(missing)} too")
    return found


def _camera(calibration: dict[str, Floats]) -> ObservationConfig:
    fu, fv, cu, cv, baseline = (float(calibration[name][0]) for name in ("fu", "fv", "cu", "cv", "b"))
    vehicle_from_camera = np.ascontiguousarray(calibration["C_c_v"].reshape(3, 3).T)
    mount = (*calibration["rho_v_c_v"].tolist(), *so3.quaternion_of(vehicle_from_camera))
    sigma = tuple(np.sqrt(calibration["y_var"]).tolist())
    return ObservationConfig("stereo", sigma, mount, Camera(fu, fv, cu, cv, baseline))


def _timed(path: Path) -> Floats:
    """A table of seven columns, the first a time that rises."""
    rows = table(path, 7, ",")
    if len(rows) < 2 or np.any(np.diff(rows[:, 0]) <= 0.0):
        raise DatasetError(f"{path}: expected two lines or more whose times rise")
    return rows


def _stereo(path: Path, t: Floats) -> tuple[NDArray[np.int64], tuple[str, ...], Floats]:
    """Steps, landmarks and readings (4, m), in order."""
    rows = table(path, 6, ",")
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    step = np.abs(t - rows[:, :1]).argmin(axis=1)
    off = np.abs(t[step] - rows[:, 0]) > _SAME_TIME
    if off.any():
        raise DatasetError(f"{path}: expected times of imu.csv, got {rows[np.argmax(off), 0]}")
    return step, tuple(str(int(mark)) for mark in rows[:, 1]), rows[:, 2:].T


def _truth(folder: Path) -> Truth | None:
    marks, track = folder / "landmarks.csv", folder / "groundtruth.csv"
    if not marks.is_file() or not track.is_file():
        return None
    rows = _timed(track)
    return Truth(
        {str(int(row[0])): row[1:] for row in table(marks, 4, ",")},
        {ROBOT: Trajectory(rows[:, 0].copy(), rows[:, 1:].copy())},
    )
