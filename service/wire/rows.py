"""From rows to one ``Batch`` of columns."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np

from service.problems import invalid
from service.wire.bearing import BearingRows, BearingStep
from service.wire.checks import (
    Floats,
    Ints,
    PathOf,
    check_covariances,
    check_others,
    check_square,
    check_steer,
    check_times,
    expected,
    names_of,
    of_sigma,
)
from service.wire.measurements import CartesianRows, CartesianStep, Odometry, RangeBearingRows, RangeBearingStep
from service.wire.spatial import Cartesian3dStep, Odometry3d, PinholeStep, SpatialRows, StereoStep
from submaps.config import Models
from submaps.measurements import Batch, encounter

Rows: TypeAlias = CartesianRows | RangeBearingRows | BearingRows | SpatialRows
PlanarStep: TypeAlias = CartesianStep | RangeBearingStep | BearingStep
Step: TypeAlias = PlanarStep | Cartesian3dStep | StereoStep | PinholeStep
Matrix = list[list[float]]


def from_rows(rows: Rows, models: Models, robot: str, association: str = "known") -> Batch:
    """Return rows of ``robot`` as a batch; raises ``Problem`` (422)."""
    steps: list[Step] = [*rows.steps]
    control_step, control, control_covariance = _controls(steps, models)
    seen: list[Any] = []
    names: list[str] = []
    step: list[int] = []
    for index, one in enumerate(steps):
        seen += one.observations
        given = [o.landmark for o in one.observations]
        names += names_of(given, association, lambda i, k=index: f"steps.{k}.observations.{i}.landmark")  # type: ignore[misc]
        if isinstance(one, PlanarStep) and one.encounters:
            met = [e.robot for e in one.encounters]
            check_others(robot, met, lambda i, k=index: f"steps.{k}.encounters.{i}.robot")  # type: ignore[misc]
            seen += one.encounters
            names += [encounter(other, one.t) for other in met]
        step += [index] * (len(seen) - len(step))
    channels = [[getattr(o, name) for o in seen] for name in models.observation.channels]
    own = [o.covariance for o in seen]
    batch = Batch(
        t=np.array([one.t for one in steps]),
        control_step=control_step,
        control=control,
        control_covariance=control_covariance,
        observation_step=np.array(step, dtype=np.int64),
        landmark=tuple(names),
        z=np.array(channels, dtype=np.float64).reshape(len(channels), len(seen)),
        observation_covariance=_filled(own, models.observation.sigma, _covariance_path(steps, step)),
    )
    check_times(batch, "steps.{}.t".format)
    return batch


def _covariance_path(steps: Sequence[Step], step: list[int]) -> PathOf:
    def path(i: int) -> str:
        within, landmarks = i - bisect_left(step, step[i]), len(steps[step[i]].observations)
        kind, at = ("observations", within) if within < landmarks else ("encounters", within - landmarks)
        return f"steps.{step[i]}.{kind}.{at}.covariance"

    return path


def _controls(steps: Sequence[Step], models: Models) -> tuple[Ints, Floats, Floats | None]:
    motion = models.motion
    # In space an odometry is called what it is in the plane; a robot without a motion model has no field at all.
    own = {"odometry3d": "odometry", "none": None}.get(motion.model, motion.model)
    others = [name for name in steps[0].CONTROLS if name != own]
    where: list[int] = []
    controls: list[Any] = []
    for index, step in enumerate(steps):
        for other in others:
            if getattr(step, other) is not None:
                raise invalid(f"steps.{index}.{other}", f"does not fit; {expected(models)}")
        control = None if own is None else getattr(step, own)
        if control is not None:
            where.append(index)
            controls.append(control)
    values = np.array([[getattr(c, name) for c in controls] for name in motion.channels], dtype=np.float64)
    values = values.reshape(len(motion.channels), len(where))
    check_steer(motion, values, lambda i: f"steps.{where[i]}.{motion.model}.steer")
    covariance = None
    if own == "odometry":
        given = [c.covariance for c in controls if isinstance(c, Odometry | Odometry3d)]
        # That of a density depends on the interval, of which a batch knows all but the first: NaN
        # stands for it, and the model fills it in.
        sigma = motion.sigma if motion.noise == "reading" else (np.nan,) * len(motion.sigma)
        covariance = _filled(given, sigma, lambda i: f"steps.{where[i]}.odometry.covariance")
    return np.array(where, dtype=np.int64), values, covariance


def _filled(given: list[Matrix | None], sigma: tuple[float, ...], path: PathOf) -> Floats | None:
    """Return the covariances given, the model's own for the rest; None where none is given."""
    where = [i for i, matrix in enumerate(given) if matrix is not None]
    if not where:
        return None
    for i in where:
        check_square(path(i), given[i] or [], len(sigma))
    own = check_covariances(np.array([given[i] for i in where]), lambda i: path(where[i]))
    filled = np.tile(of_sigma(sigma), (len(given), 1, 1))
    filled[where] = own
    return filled
