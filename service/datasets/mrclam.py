"""Reader of the UTIAS Multi-Robot Cooperative Localization and Mapping data sets, a folder each.

Five robots among fifteen landmarks (Leung, Halpern, Barfoot, Liu, IJRR 30(8) 2011)::

    Barcodes.dat              subject  barcode
    RobotN_Odometry.dat       time  v  omega
    RobotN_Measurement.dat    time  barcode  range  bearing
    RobotN_Groundtruth.dat    time  x  y  theta                 (Vicon; some folders lack it)
    Landmark_Groundtruth.dat  subject  x  y  sigma_x  sigma_y

Subjects 1 to 5 are the robots, the others landmarks; a measurement names a barcode. Times of all
robots are on one clock; here they count from the second in which the first odometry begins.

**Steps.** A reading (v, omega) holds until the next one. A robot has a step wherever its reading
changes and wherever it saw something; readings equal to the one before add none. Where the reading
is (0, 0) the step has no control: robot 4 of mrclam_7 stood for 45 % of the time, and over 2 s and
more it then moved by less than 0.1 mm and 0.5 mrad. Of two readings at one time the later one counts;
readings before one that has been read, barcodes that belong to nobody, and measurements outside the
odometry's span are left out. ``notes`` count all of these.

**Noise**, measured on mrclam_7 against Vicon. The odometry is the commanded velocity. The root mean
square of its error over T seconds, by sqrt(T), is for the five robots 0.012 to 0.014 m forward and 0.041
to 0.064 rad at T = 1 s, 0.014 to 0.018 m and 0.038 to 0.057 rad at 2 s, 0.016 to 0.020 m and 0.036 to
0.052 rad at 5 s: hardly white, since the robots are 5 to 8 % slower than told and late to turn.
Sideways it is 0.0015 to 0.0021 m at 0.25 s, and after that what the heading explains. Ranges and
bearings of landmarks are off by 0.111 to 0.190 m and 0.010 to 0.025 rad (standard deviation within
3.7 sigma), 0.5 to 2.6 % of them by more. Successive range errors of a landmark correlate by about
0.8, which no filter here knows of: expect covariances that are too small.

The densities go with the top speed that the robots are told. In mrclam_9 it is 3.4 times that of
mrclam_7; there the batch optimum's corrections of the odometry are 0.024 m and 0.155 rad per root second,
against 0.013 m and 0.034 rad in mrclam_7.

**Truth** is of the robots' Vicon bodies, whose frames need not be those of the odometry: in mrclam_7
bearings put them within 5 cm and 0.008 rad of one another.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from service.datasets.dataset import Dataset, DatasetError, Truth
from service.datasets.lines import table
from submaps.config import MapConfig, MotionConfig, ObservationConfig
from submaps.measurements import Batch, encounter
from submaps.trajectory import Trajectory

Floats = NDArray[np.float64]

ROBOTS = range(1, 6)
GATE = 0.999
SIGMA, SPEED = (0.015, 0.045, 0.0015), 0.086  # m, rad, m, each per root second, at this top speed (m/s)
RANGE_SIGMA, BEARING_SIGMA = 0.15, 0.02
BARCODES, LANDMARKS = "Barcodes.dat", "Landmark_Groundtruth.dat"
_MICROSECOND = 6  # decimals of a second that the files' times are good for


def is_mrclam(path: Path) -> bool:
    """Whether a path is such a folder."""
    return (path / BARCODES).is_file()


def read_mrclam(folder: Path) -> Dataset:
    """Read one folder; raises ``DatasetError``, naming the file and the line, where it is not as expected."""
    subjects = _subjects(folder)
    numbers = [n for n in ROBOTS if _file(folder, n, "Odometry").is_file()]
    if not numbers:
        raise DatasetError(f"{folder}: expected a file Robot1_Odometry.dat (or of another robot), found none")
    notes: dict[str, int] = {}
    odometry = {n: _odometry(_file(folder, n, "Odometry"), notes) for n in numbers}
    origin = math.floor(min(float(readings[0, 0]) for readings in odometry.values()))
    robots = {}
    for n in numbers:
        sightings = _sightings(_file(folder, n, "Measurement"), subjects, n, odometry[n], notes)
        robots[_name(n)] = _batch(odometry[n], sightings, origin)
    faster = max(float(np.abs(readings[:, 1]).max()) for readings in odometry.values()) / SPEED
    config = MapConfig(
        MotionConfig("velocity", tuple(s * (faster or 1.0) for s in SIGMA), noise="density"),
        ObservationConfig("range_bearing", (RANGE_SIGMA, BEARING_SIGMA)),
        gate=GATE,
    )
    return Dataset(folder.resolve().name, config, robots, _truth(folder, numbers, origin), notes)


@dataclass(frozen=True)
class _Sightings:
    """What one robot saw, in order of time; ``subject`` is a number of the data set."""

    t: Floats
    subject: NDArray[np.int64]
    z: Floats  # (m, 2) range m, bearing rad


def _name(number: int) -> str:
    return f"robot{number}"


def _file(folder: Path, number: int, kind: str) -> Path:
    return folder / f"Robot{number}_{kind}.dat"


def _count(notes: dict[str, int], name: str, number: int) -> None:
    if number:
        notes[name] = notes.get(name, 0) + number


# -- files ---------------------------------------------------------------------------------------


def _subjects(folder: Path) -> dict[int, int]:
    """Subjects by their barcodes."""
    return {int(barcode): int(subject) for subject, barcode in table(folder / BARCODES, 2)}


def _truth(folder: Path, robots: list[int], origin: float) -> Truth | None:
    path = folder / LANDMARKS
    if not path.is_file():
        return None
    landmarks = {str(int(row[0])): row[1:3] for row in table(path, 5)}
    tracks = {}
    for n in robots:
        if _file(folder, n, "Groundtruth").is_file():
            rows = table(_file(folder, n, "Groundtruth"), 4)
            rows = rows[np.argsort(rows[:, 0], kind="stable")]
            tracks[_name(n)] = Trajectory(_seconds(rows[:, 0], origin), np.ascontiguousarray(rows[:, 1:]))
    return Truth(landmarks, tracks)


def _seconds(t: Floats, origin: float) -> Floats:
    return np.asarray(np.round(t - origin, _MICROSECOND))


# -- a robot -------------------------------------------------------------------------------------


def _odometry(path: Path, notes: dict[str, int]) -> Floats:
    """Readings (n, 3) time, v, omega with rising times."""
    rows = table(path, 3)
    if not len(rows):
        raise DatasetError(f"{path}: expected lines of time, v and omega, found none")
    before = np.concatenate([[-np.inf], np.maximum.accumulate(rows[:, 0])[:-1]])
    backward = rows[:, 0] < before
    _count(notes, "odometry readings earlier than the one before", int(backward.sum()))
    rows = rows[~backward]
    last_of_its_time = np.append(np.diff(rows[:, 0]) > 0.0, True)
    _count(notes, "odometry readings at the time of another", int((~last_of_its_time).sum()))
    return np.asarray(rows[last_of_its_time])


def _sightings(path: Path, subjects: dict[int, int], own: int, odometry: Floats, notes: dict[str, int]) -> _Sightings:
    rows = table(path, 4)
    if np.any(rows[:, 2] <= 0.0):
        raise DatasetError(f"{path}: expected ranges above 0, got {rows[:, 2].min()}")
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    subject = np.array([subjects.get(int(barcode), -1) for barcode in rows[:, 1]], dtype=np.int64)
    early, late = rows[:, 0] < odometry[0, 0], rows[:, 0] > odometry[-1, 0]
    reasons = {
        "measurements of an unknown barcode": subject < 0,
        "measurements of the robot's own barcode": subject == own,
        "measurements before the first odometry": early,
        "measurements after the last odometry": late,
    }
    good = np.ones(len(rows), dtype=bool)
    for reason, holds in reasons.items():
        _count(notes, reason, int((good & holds).sum()))
        good &= ~holds
    return _Sightings(rows[good, 0], subject[good], rows[good, 2:])


def _batch(odometry: Floats, seen: _Sightings, origin: float) -> Batch:
    """Steps where the reading changes, where it ends, and where something was seen."""
    changes = np.append(True, np.any(np.diff(odometry[:, 1:], axis=0) != 0.0, axis=1))
    changes[-1] = True
    t = np.unique(np.concatenate([odometry[changes, 0], seen.t]))
    held = odometry[np.searchsorted(odometry[:, 0], t[:-1], side="right") - 1, 1:]  # over [t_k, t_k+1)
    moves = np.any(held != 0.0, axis=1)
    step = np.searchsorted(t, seen.t)
    meets = np.isin(seen.subject, ROBOTS)
    order = np.lexsort((meets, step))  # stable: within a step landmarks first, else the file's order
    seconds = _seconds(t, origin)
    return Batch(
        t=seconds,
        control_step=np.flatnonzero(moves) + 1,
        control=np.ascontiguousarray(held[moves].T),
        control_covariance=None,
        observation_step=step[order],
        landmark=tuple(_seen(int(seen.subject[i]), float(seconds[step[i]])) for i in order),
        z=np.ascontiguousarray(seen.z[order].T),
        observation_covariance=None,
    )


def _seen(subject: int, t: float) -> str:
    return encounter(_name(subject), t) if subject in ROBOTS else str(subject)
