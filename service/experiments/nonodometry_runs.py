"""The runs of ``nonodometry``: one noise set from one start, through every filter."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from submaps.filtering.unscented import Scaling
from submaps.nonodometry import sigma_poses
from submaps.nonodometry.belief import Belief, Status
from submaps.nonodometry.errors import euclidean, mahalanobis, shape
from submaps.nonodometry.initial import from_views, noisy
from submaps.nonodometry.moments import Filter, Unscented, extended
from submaps.nonodometry.poses import Poses
from submaps.nonodometry.sensor import Camera
from submaps.nonodometry.spiral import observe, spiral
from submaps.nonodometry.update import update

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Setting:
    """The sigma points' scaling, and the noise (pixels) of the views."""

    scaling: Scaling
    noise: float = 1.0

    @property
    def camera(self) -> Camera:
        """A camera of that noise."""
        return Camera(self.noise, focal=(500.0, 500.0), centre=(320.0, 240.0))


BASE = Setting(Scaling(alpha=0.1, beta=2.0, kappa=0.0))
OTHERS = (
    Setting(Scaling(alpha=0.001)),
    Setting(Scaling(alpha=1.0)),
    Setting(Scaling(alpha=0.1), noise=2.5),
    Setting(Scaling(alpha=1.0), noise=2.5),
    Setting(Scaling(alpha=1.0, beta=0.0), noise=2.5),
)
NOISY = {"σ 0.01": 0.01, "σ 0.1": 0.1}
FROM_VIEWS = {"4 views": 4, "16 views": 16, "64 views": 64}
STARTS = (*NOISY, *FROM_VIEWS)
HARD = ("σ 0.1", "4 views")  # the starts on which other settings are tried as well
VARIANTS = {
    "UKF constant": sigma_poses.constant,
    "UKF linear": sigma_poses.linear,
    "UKF likelihood": sigma_poses.maximum_likelihood,
}
FILTERS = ("EKF", *VARIANTS)


@dataclass(frozen=True)
class Job:
    """One noise set from one start, for some filters."""

    number: int
    seed: np.random.SeedSequence
    start: str
    filters: tuple[str, ...]
    setting: Setting


@dataclass(frozen=True)
class Run:
    """How one filter did: its errors are None where it failed, and ``status`` says how."""

    number: int
    start: str
    filter: str
    setting: Setting
    status: str
    updates: int
    seconds: float
    euclidean: float | None = None
    shape: float | None = None
    mahalanobis: float | None = None

    @property
    def done(self) -> bool:
        """Whether it reached the last view."""
        return self.euclidean is not None


def process(job: Job) -> list[Run]:
    """Every filter of a job on the same views from the same start."""
    world = spiral()
    rng = np.random.default_rng(job.seed)
    z = observe(world, job.setting.camera, rng)
    first = world.poses.take(0)
    begin: tuple[Belief, int, Poses] | None
    if job.start in NOISY:
        begin = noisy(world.points, NOISY[job.start], rng), 0, first
    else:
        begin = _from_views(job.setting.camera, z[: FROM_VIEWS[job.start]], first, world.poses)
    return [_follow(job, name, begin, z, world.points) for name in job.filters]


def _from_views(camera: Camera, z: Floats, first: Poses, truth: Poses) -> tuple[Belief, int, Poses] | None:
    baseline = float(np.linalg.norm(truth.position[len(z) - 1] - truth.position[0]))
    found = from_views(camera, z, first, baseline)
    return (found.belief, len(z), found.poses.take(len(z) - 1)) if found.found else None


def _follow(job: Job, name: str, begin: tuple[Belief, int, Poses] | None, z: Floats, truth: Floats) -> Run:
    """One filter through the views that are left."""
    about = (job.number, job.start, name, job.setting)
    if begin is None:
        return Run(*about, "no start", 0, 0.0)
    belief, k, pose = begin
    camera = job.setting.camera
    filter_: Filter = extended if name == "EKF" else Unscented(VARIANTS[name], job.setting.scaling)
    began = time.process_time()
    for number, view in enumerate(z[k:], start=1):
        after = update(filter_, camera, belief, view, pose)
        if after.status is not Status.done or after.pose is None:
            return Run(*about, after.status.name, number, time.process_time() - began)
        belief, pose = after.belief, after.pose
    seconds = time.process_time() - began
    errors = euclidean(belief.points, truth), shape(belief.points, truth), mahalanobis(belief, truth)
    return Run(*about, "done", len(z) - k, seconds, *errors)
