"""From measurements as sent to one ``Batch`` of columns, checked as a whole."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from service.problems import invalid
from service.wire.base import Wire, parse, shown
from service.wire.bearing import BearingRows
from service.wire.checks import (
    Floats,
    Ints,
    PathOf,
    check,
    check_covariances,
    check_others,
    check_square,
    check_steer,
    check_times,
    check_turns,
    expected,
    in_space,
    names_of,
    of_sigma,
    unnamed,
)
from service.wire.measurements import CartesianRows, Columns, EncounterColumns, ObservationColumns, RangeBearingRows
from service.wire.rows import from_rows
from service.wire.spatial import Cartesian3dRows, PinholeRows, StereoRows
from submaps.config import Models, ObservationConfig
from submaps.measurements import Batch, encounter

ROWS_TYPE = "application/json"
COLUMNS_TYPE = "application/vnd.submaps.columns+json"

_COLUMNS = TypeAdapter(Columns)
# By observation model.
ROWS: dict[str, type[Wire]] = {
    "cartesian": CartesianRows,
    "range_bearing": RangeBearingRows,
    "bearing": BearingRows,
    "cartesian3d": Cartesian3dRows,
    "stereo": StereoRows,
    "pinhole": PinholeRows,
}
_ROWS: dict[str, TypeAdapter[Any]] = {model: TypeAdapter(rows) for model, rows in ROWS.items()}
NOT_IN_SPACE = "robots that see one another are of maps in se2; this one is in se3"
_NO_INTS: Ints = np.empty(0, np.int64)


@dataclass(frozen=True)
class Decoded:
    """A batch, its sequence, and how its sender calls the time of a step."""

    sequence: int
    batch: Batch
    time_path: PathOf


def decode(content_type: str, body: bytes, models: Models, robot: str, association: str = "known") -> Decoded:
    """Return the measurements of ``robot``, which has these models, in a body of one of the two content types.

    ``association`` is the map's: whether observations name their landmarks.
    Raises ``Problem``: 400, 415 or 422.
    """

    def hint(error: Mapping[str, Any]) -> str | None:
        if error["loc"][-1:] == ("encounters",) and in_space(models):
            return NOT_IN_SPACE
        inside = len(error["loc"]) > 1 and error["type"] in ("missing", "extra_forbidden")
        return expected(models) if inside else None

    if content_type == COLUMNS_TYPE:
        columns = parse(_COLUMNS, body, hint)
        return Decoded(columns.sequence, from_columns(columns, models, robot, association), "t.{}".format)
    rows = parse(_ROWS[models.observation.model], body, hint)
    return Decoded(rows.sequence, from_rows(rows, models, robot, association), "steps.{}.t".format)


def from_columns(columns: Columns, models: Models, robot: str, association: str = "known") -> Batch:
    """Return columns of ``robot`` as a batch; raises ``Problem`` (422)."""
    t = np.array(columns.t)
    control_step, control = _controls(columns, models, t.size)
    of_control = 6 if in_space(models) else 3
    covariance = _matrices("control_covariance", columns.control_covariance, of_control, control_step.size)
    if covariance is not None and models.motion.model not in ("odometry", "odometry3d"):
        raise invalid("control_covariance", f"only an odometry may carry one; {expected(models)}")
    if columns.encounter is not None and in_space(models):
        raise invalid("encounter", NOT_IN_SPACE)
    seen = _sightings(columns, models.observation, robot, association)
    batch = Batch(
        t=t,
        control_step=control_step,
        control=control,
        control_covariance=covariance,
        observation_step=seen.step,
        landmark=seen.name,
        z=seen.z,
        observation_covariance=seen.covariance,
    )
    check_times(batch, "t.{}".format)
    return batch


def _controls(columns: Columns, models: Models, steps: int) -> tuple[Ints, Floats]:
    motion = models.motion
    if columns.control is None:
        for name in ("control_step", "control_covariance"):
            if getattr(columns, name) is not None:
                raise invalid(name, "given without control")
        return _NO_INTS, np.empty((len(motion.channels), 0))
    if not motion.channels:
        raise invalid("control", f"does not fit; {expected(models)}")
    if columns.control_step is None:
        step = np.arange(steps, dtype=np.int64)
    else:
        step = _steps("control_step", columns.control_step, steps, least_rise=1)
    control = _channels("control", columns.control, motion.channels, step.size)
    check_steer(motion, control, "control.1.{}".format)
    check_turns(motion.model, control, "control.{}.{}".format)
    return step, control


# -- what was seen -------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Sightings:
    """Observations of landmarks, encounters with robots, or both."""

    step: Ints
    name: tuple[str, ...]
    z: Floats
    covariance: Floats | None


def _sightings(columns: Columns, model: ObservationConfig, robot: str, association: str) -> _Sightings:
    seen, met = columns.observation, columns.encounter
    steps = len(columns.t)
    if seen is None:
        landmarks = _Sightings(_NO_INTS, (), np.empty((len(model.channels), 0)), None)
    else:
        landmarks = _checked("observation", seen, "landmark", _names(seen, association), model, steps)
    if met is None:
        return landmarks
    robots = _checked("encounter", met, "robot", met.robot, model, steps)
    check_others(robot, met.robot, "encounter.robot.{}".format)
    names = tuple(encounter(other, columns.t[k]) for other, k in zip(met.robot, met.step, strict=True))
    return _merged(landmarks, _Sightings(robots.step, names, robots.z, robots.covariance), model)


def _names(seen: ObservationColumns, association: str) -> list[str]:
    where = "observation.landmark"
    if seen.landmark is None:
        return names_of([None] * len(seen.step), association, lambda _: where)
    if association != "known":
        raise invalid(where, f"expected none; {unnamed(association)}")
    return seen.landmark


def _checked(
    where: str, seen: ObservationColumns | EncounterColumns, ids: str, names: list[str], model: ObservationConfig,
    steps: int,
) -> _Sightings:  # fmt: skip
    step = _steps(f"{where}.step", seen.step, steps, least_rise=0)
    if len(names) != step.size:
        raise invalid(
            f"{where}.{ids}", f"got {len(names)}, expected one for each of {step.size} entries of {where}.step"
        )
    z = _channels(f"{where}.z", seen.z, model.channels, step.size)
    if model.model == "range_bearing" and min(seen.z[0], default=1.0) <= 0.0:
        check(z[0] > 0.0, lambda i: f"{where}.z.0.{i}", z[0], "a range above 0")
    check_turns(model.model, z, lambda c, i: f"{where}.z.{c}.{i}")
    covariance = _matrices(f"{where}.covariance", seen.covariance, len(model.channels), step.size)
    return _Sightings(step, tuple(names), z, covariance)


def _merged(landmarks: _Sightings, robots: _Sightings, model: ObservationConfig) -> _Sightings:
    """Return both in the order of their steps; within a step, robots come after landmarks."""
    step = np.concatenate([landmarks.step, robots.step])
    order = np.argsort(step, kind="stable")
    names = landmarks.name + robots.name
    covariance = None
    if landmarks.covariance is not None or robots.covariance is not None:
        covariance = np.concatenate([_each(landmarks, model), _each(robots, model)])[order]
    z = np.ascontiguousarray(np.concatenate([landmarks.z, robots.z], axis=1)[:, order])
    return _Sightings(step[order], tuple(names[i] for i in order), z, covariance)


def _each(seen: _Sightings, model: ObservationConfig) -> Floats:
    if seen.covariance is not None:
        return seen.covariance
    return np.tile(of_sigma(model.sigma), (seen.step.size, 1, 1))


# -- lists of numbers ----------------------------------------------------------------------------


def _steps(name: str, given: list[int], steps: int, *, least_rise: int) -> Ints:
    # Whether all is well is asked of the lists, which is faster where a batch is one step.
    if max(given, default=0) >= steps:
        first = next(i for i, step in enumerate(given) if step >= steps)
        raise invalid(f"{name}.{first}", f"got {shown(given[first])}, expected a step from 0 to {steps - 1}")
    step = np.array(given, dtype=np.int64)
    if given != sorted(given) or (least_rise and len(set(given)) < len(given)):
        rises = np.diff(step, prepend=-1) >= least_rise
        order = "rising" if least_rise else "not falling"
        check(rises, lambda i: f"{name}.{i}", step, f"steps in order, {order}")
    return step


def _channels(name: str, rows: list[list[float]], channels: tuple[str, ...], width: int) -> Floats:
    if len(rows) != len(channels):
        raise invalid(name, f"got {len(rows)} lists, expected {len(channels)}: {', '.join(channels)}")
    for channel, row in enumerate(rows):
        if len(row) != width:
            raise invalid(f"{name}.{channel}", f"got {len(row)} numbers, expected {width}, one each")
    return np.array(rows, dtype=np.float64).reshape(len(channels), width)


def _matrices(name: str, rows: list[list[list[float]]] | None, size: int, count: int) -> Floats | None:
    if rows is None:
        return None
    if len(rows) != count:
        raise invalid(name, f"got {len(rows)} matrices, expected {count}, one each")
    for i, matrix in enumerate(rows):
        check_square(f"{name}.{i}", matrix, size)
    matrices = np.array(rows, dtype=np.float64).reshape(count, size, size)
    return check_covariances(matrices, lambda i: f"{name}.{i}")
