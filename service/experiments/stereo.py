"""``stereo``: Starry Night, a real stereo head over twenty landmarks, against Vicon."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from service.datasets.dataset import Dataset, DatasetError
from service.datasets.starry_night import is_starry_night, read_starry_night
from service.experiments.base import Experiment, Outcome, Runs, Table
from submaps.atlas.joining import join
from submaps.batch import optimum
from submaps.config import Depth, ObservationConfig
from submaps.evaluation import absolute_error, associate, point_error
from submaps.mapper import Mapper
from submaps.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

# The camera hangs some two metres above the landmarks.
DEPTH = Depth(2.5, 1.0)
JOINED, ONE, STANDARD, BATCH = "sub-maps joined", "one map", "standard EKF, one map", "batch optimum"
ONE_CAMERA = "sub-maps joined, left camera alone"
WITH = (JOINED, ONE, STANDARD, BATCH, ONE_CAMERA)
WITHOUT = (JOINED, ONE, BATCH)
FEW = 8  # landmarks in a sub-map without odometry: all twenty would fit into one
LIMIT = 1.1  # of the batch solution's landmark error


@dataclass(frozen=True)
class Task:
    """One way of estimating, with odometry or without."""

    folder: Path
    way: str
    odometry: bool


@dataclass(frozen=True)
class Told:
    """What one way made of the run: landmarks (20, 3) and positions (n, 3), aligned to Vicon's, errors in m.

    ``nees`` is of the landmarks, ``nis`` the mean per degree of freedom of all readings; the optimum has its chi-square
    per degree of freedom in place of the latter, and no covariance.
    """

    task: Task
    landmark_rmse: float
    trajectory_rmse: float
    nees: float | None
    nis: float | None
    submaps: int
    lost: int
    landmarks: Floats
    positions: Floats


def folder() -> Path:
    """Where the run lies; raises ``DatasetError``."""
    root = Path(os.environ.get("SUBMAPS_DATA", Path(__file__).parents[3] / "shared" / "data"))
    path = root / "starry_night"
    if not is_starry_night(path):
        raise DatasetError(f"{path}: no Starry Night there; SUBMAPS_DATA names the folder that holds starry_night")
    return path


def estimate(task: Task) -> Told:
    """Estimate the run in one way."""
    run = read_starry_night(task.folder, odometry=task.odometry)
    if task.way == BATCH:
        return _optimum(task, run)
    if task.way == ONE_CAMERA:
        run = _left(run)
    return _mapped(task, run)


def _left(run: Dataset) -> Dataset:
    """The run as the left camera saw it: the depth of a new landmark from a prior."""
    both = run.observation
    assert both.camera is not None
    camera = replace(both.camera, baseline=0.0)
    seen = ObservationConfig("pinhole", both.sigma[:2], both.mount, camera, DEPTH)
    (robot, batch), *_ = run.robots.items()
    left = replace(batch, z=np.ascontiguousarray(batch.z[:2]))
    return replace(run, config=replace(run.config, observation=seen), robots={robot: left})


def _mapped(task: Task, run: Dataset) -> Told:
    config = run.config
    if task.way in (ONE, STANDARD):
        bounds = {"max_landmarks": 1000, "max_heading_sigma": 1e9, "max_position_sigma": 1e9}
        name = "standard" if task.way == STANDARD else config.filter
        config = replace(config, filter=name, **bounds)  # type: ignore[arg-type]
    elif not task.odometry:
        config = replace(config, max_landmarks=FEW)  # nothing else would end a sub-map
    ((robot, batch),) = run.robots.items()
    mapper = Mapper(config)
    report = mapper.apply(robot, batch)
    mapper.install(join(mapper.problem()))
    view = mapper.view()
    frames = [view.frame_in(k, "map") for k in range(view.submap_count)]
    space = config.geometry
    poses = np.array([
        space.compose(frames[k], space.as_pose(pose))
        for k, pose in zip(report.track_submap.tolist(), report.track_pose, strict=True)
    ])  # fmt: skip
    lost = np.unique([r.step for r in report.rejected if r.reason == "lost"]).astype(np.int64)
    kept = np.setdiff1d(np.arange(batch.steps), lost)
    found, _ = view.landmarks(limit=1000)
    submaps = [view.state.submap(k) for k in range(view.submap_count)]
    channels = len(config.observation.channels)
    nis = sum(s.nis_sum for s in submaps) / (channels * max(sum(s.nis_count for s in submaps), 1))
    points, covariances = np.array([e.position for e in found]), np.array([e.covariance for e in found])
    track = Trajectory(batch.t[kept], poses[kept])
    told = _against_vicon(task, run, [e.id for e in found], points, covariances, track)
    return replace(told, nis=float(nis), submaps=view.submap_count, lost=len(lost))


def _optimum(task: Task, run: Dataset) -> Told:
    (batch,) = run.robots.values()
    best = optimum(batch, run.motion, run.observation)
    known = ~np.isnan(best.poses).any(axis=1)
    track = Trajectory(batch.t[known], best.poses[known])
    told = _against_vicon(task, run, list(best.ids), best.landmarks, None, track)
    return replace(told, nis=best.chi2 / best.freedom, lost=int(np.count_nonzero(~known)))


def _against_vicon(
    task: Task, run: Dataset, names: list[str], points: Floats, covariances: Floats | None, track: Trajectory
) -> Told:
    assert run.truth is not None
    truth = np.array([run.truth.landmarks[name] for name in names])
    flat = np.tile(np.eye(3), (len(names), 1, 1))
    errors = point_error(points, flat if covariances is None else covariances, truth)
    (vicon,) = run.truth.trajectories.values()
    own, there = associate(track, vicon, 0.01)
    return Told(
        task, errors.statistics.rmse, absolute_error(own, there).rmse, None if covariances is None else errors.nees,
        None, 1, 0, errors.alignment.apply(points), errors.alignment.apply(own.positions),
    )  # fmt: skip


def run(runs: Runs) -> Outcome:
    """Every way, with odometry and without."""
    where = folder()
    tasks = [Task(where, way, True) for way in WITH] + [Task(where, way, False) for way in WITHOUT]
    results = runs.each(estimate, tasks, "ways")
    table = Table(
        ("odometry", "way", "landmarks (m)", "trajectory (m)", "landmark NEES", "NIS", "sub-maps", "steps lost"),
        tuple(
            ("with" if r.task.odometry else "without", r.task.way, r.landmark_rmse, r.trajectory_rmse, r.nees, r.nis,
             r.submaps, r.lost)
            for r in results
        ),
    )  # fmt: skip
    ways = [dict(zip(table.columns, row, strict=True)) for row in table.rows]
    found = {(r.task.odometry, r.task.way): r for r in results}
    ratio = found[True, JOINED].landmark_rmse / found[True, BATCH].landmark_rmse
    truth = read_starry_night(where).truth
    assert truth is not None
    vicon = np.array(list(truth.landmarks.values()))
    (track,) = truth.trajectories.values()

    def draw(figure: Figure) -> None:
        from service.experiments import stereo_picture  # the extra "plot"

        stereo_picture.draw(figure, found[True, JOINED], found[False, JOINED], vicon, track.positions)

    return Outcome(
        summary=f"Joined sub-maps put the landmarks {found[True, JOINED].landmark_rmse:.4f} m from Vicon, {ratio:.2f} "
        f"times the batch optimum's {found[True, BATCH].landmark_rmse:.4f} m (limit {LIMIT}); without odometry "
        f"{found[False, JOINED].landmark_rmse:.4f} m beside {found[False, BATCH].landmark_rmse:.4f} m.",
        table=table,
        figures={"ratio_to_batch": ratio, "limit": LIMIT, "ways": ways},
        series=_series(results),
        draw=draw,
        assumptions=(
            "The calibration file's variances, for a reading of the IMU and of a pixel alike, with no gate.",
            f"One camera: the left one's pixels, depth of a new landmark {DEPTH.mean} m, sigma {DEPTH.sigma} m.",
            f"Without odometry a sub-map holds {FEW} landmarks at most, and a step that shows fewer than three that "
            "it knows is lost; steps that show fewer than three at all are left out.",
            "Landmarks and trajectory are each aligned to Vicon's by a rigid motion of their own.",
        ),
        size=(12.0, 5.6),
    )  # fmt: skip


def _series(results: list[Told]) -> Table:
    """Every aligned landmark and every tenth position of each way."""
    rows: list[tuple[object, ...]] = []
    for r in results:
        odometry = "with" if r.task.odometry else "without"
        rows += [(odometry, r.task.way, "landmark", *p) for p in r.landmarks.tolist()]
        rows += [(odometry, r.task.way, "position", *p) for p in r.positions[::10].tolist()]
    return Table(("odometry", "way", "kind", "x", "y", "z"), tuple(rows))


EXPERIMENT = Experiment("stereo", "Starry Night against Vicon, with and without odometry", 1, run)
