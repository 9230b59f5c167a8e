"""Robots that drive round one another among a few landmarks, for tests of what several robots are for."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from service.datasets import Dataset, Truth
from submaps.config import MapConfig, MotionConfig, ObservationConfig
from submaps.geometry.se2 import Pose, compose, exp
from submaps.measurements import Batch, as_encounter, encounter
from submaps.trajectory import Trajectory

Floats = NDArray[np.float64]

DT, STEPS = 0.5, 80
MOTION = MotionConfig("velocity", (0.02, 0.02, 0.005), noise="density")
OBSERVATION = ObservationConfig("range_bearing", (0.05, 0.02), (0.1, 0.05, 0.2))
LANDMARKS = {
    "oak": (4.0, 3.0), "elm": (-3.0, 5.0), "ash": (1.0, 9.0), "fir": (8.0, 6.0), "yew": (5.0, -2.0),
    "bay": (-1.0, -3.0),
}  # fmt: skip
# Where each robot begins, its speed (m/s) and its turn (rad/s); their clocks tick beside one another.
ROBOTS: dict[str, tuple[Pose, float, float]] = {"ann": ((0.0, 0.0, 0.0), 0.5, 0.1), "bob": ((6.0, 1.0, 2.0), 0.4, 0.12)}


@dataclass(frozen=True)
class Fleet:
    """Measurements of each robot, and its true poses (n, 3) at its steps."""

    robots: dict[str, Batch]
    poses: dict[str, Floats]


def pose_at(robot: str, t: float, begin: float) -> Pose:
    """Where a robot is after driving on its arc."""
    start, v, omega = ROBOTS[robot]
    return compose(start, exp((v * (t - begin), 0.0, omega * (t - begin))))


def drive(
    noise: float,
    *,
    landmarks: bool = True,
    meet: bool = True,
    seed: int = 1,
    outliers: float = 0.0,
    every: int = 2,
    observation: ObservationConfig = OBSERVATION,
) -> Fleet:
    """Drive both, seeing at each ``every``-th step.

    ``noise`` scales all sigmas; a share of the readings are ``outliers``.
    """
    random = np.random.default_rng(seed)
    robots, poses = {}, {}
    begin = {name: 0.13 * k for k, name in enumerate(ROBOTS)}  # so that nobody is seen at a step of its own
    for name, (_, v, omega) in ROBOTS.items():
        t = begin[name] + DT * np.arange(STEPS, dtype=np.float64)
        own = np.array([pose_at(name, at, begin[name]) for at in t])
        seen: list[tuple[int, str, Floats]] = []
        for k in range(0, STEPS, every):
            points = list(LANDMARKS.items()) if landmarks else []
            shown = [(mark, np.array(point)) for mark, point in points]
            if meet:
                shown += [
                    (encounter(other, float(t[k])), np.array(pose_at(other, t[k], begin[other])[:2]))
                    for other in ROBOTS
                    if other != name and begin[other] <= t[k] <= begin[other] + DT * (STEPS - 1)
                ]
            seen += [(k, mark, reading(observation, own[k], point)) for mark, point in shown]
        z = np.array([r for _, _, r in seen]) + noise * random.normal(size=(len(seen), 2)) * observation.sigma
        gross = random.uniform(size=len(seen)) < outliers
        z[gross] += random.normal(size=(int(gross.sum()), 2)) * (3.0, 1.0)
        z[:, 0] = np.maximum(z[:, 0], 0.1)
        density = noise * np.array(MOTION.sigma[:2])[:, np.newaxis] / np.sqrt(DT)
        control: Floats = np.tile([[v], [omega]], STEPS - 1) + density * random.normal(size=(2, STEPS - 1))
        robots[name] = Batch(
            t, np.arange(1, STEPS), control, None, np.array([k for k, _, _ in seen]),
            tuple(mark for _, mark, _ in seen), np.ascontiguousarray(z.T), None,
        )  # fmt: skip
        poses[name] = own
    return Fleet(robots, poses)


def reading(observation: ObservationConfig, pose: Floats, point: Floats) -> Floats:
    """Range and bearing of a point from the sensor."""
    body = complex(*(point - pose[:2])) * np.exp(-1j * pose[2])
    sensor = (body - complex(*observation.mount[:2])) * np.exp(-1j * observation.mount[2])
    return np.array([np.abs(sensor), np.angle(sensor)])


def dataset(fleet: Fleet) -> Dataset:
    """The run with its truth, which lies in another frame than any map."""
    x, y, turn = 10.0, -4.0, 1.3
    tracks = {}
    for name, poses in fleet.poses.items():
        moved = np.array([compose((x, y, turn), (float(p[0]), float(p[1]), float(p[2]))) for p in poses])
        tracks[name] = Trajectory(fleet.robots[name].t, moved)
    marks = {name: np.array(compose((x, y, turn), (*point, 0.0))[:2]) for name, point in LANDMARKS.items()}
    return Dataset("Two Robots", MapConfig(MOTION, OBSERVATION), fleet.robots, Truth(marks, tracks), {"lost": 3})


def write_mrclam(fleet: Fleet, folder: Path) -> None:
    """The run as an MRCLAM folder, whose sensors sit in the middle of their robots: give ``drive`` such a one."""
    truth = dataset(fleet).truth
    if truth is None:
        raise ValueError("a simulated run has its truth")
    folder.mkdir()
    robots = {name: k for k, name in enumerate(fleet.robots, start=1)}
    subjects = {**robots, **{name: k for k, name in enumerate(LANDMARKS, start=6)}}
    _write(folder / "Barcodes.dat", [(k, 10 * k) for k in subjects.values()])
    _write(folder / "Landmark_Groundtruth.dat", [(subjects[m], *p.tolist(), 0, 0) for m, p in truth.landmarks.items()])
    for name, k in robots.items():
        batch, track = fleet.robots[name], truth.trajectories[name]
        held = np.vstack([batch.control.T, [0.0, 0.0]])
        _write(folder / f"Robot{k}_Odometry.dat", np.column_stack([batch.t, held]).tolist())
        _write(folder / f"Robot{k}_Groundtruth.dat", np.column_stack([track.t, track.poses]).tolist())
        seen = []
        for step, mark, z in zip(batch.observation_step.tolist(), batch.landmark, batch.z.T.tolist(), strict=True):
            met = as_encounter(mark)
            seen.append((batch.t[step], 10 * subjects[mark if met is None else met[0]], *z))
        _write(folder / f"Robot{k}_Measurement.dat", seen)


def _write(path: Path, rows: Iterable[Iterable[float]]) -> None:
    path.write_text("".join(" ".join(f"{value:.9g}" for value in row) + "\n" for row in rows))
