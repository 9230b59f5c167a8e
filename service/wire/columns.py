"""From measurements as sent to one ``Batch`` of columns, checked as a whole."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from service.problems import Problem, invalid
from service.wire.base import parse, shown
from service.wire.measurements import (
    CartesianObservation,
    CartesianRows,
    CartesianStep,
    Columns,
    ObservationColumns,
    Odometry,
    RangeBearingObservation,
    RangeBearingRows,
    RangeBearingStep,
)
from submaps.config import MapConfig
from submaps.measurements import Batch

ROWS_TYPE = "application/json"
COLUMNS_TYPE = "application/vnd.submaps.columns+json"
SYMMETRIC = 1e-9  # a covariance may differ from its transpose by this share of its diagonal
PIVOT = 1e-12  # of its diagonal, below which a pivot of a covariance is no longer positive
LEAST_VARIANCE = 1e-12

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_COLUMNS = TypeAdapter(Columns)
_ROWS: dict[str, TypeAdapter[Any]] = {
    "cartesian": TypeAdapter(CartesianRows),
    "range_bearing": TypeAdapter(RangeBearingRows),
}
_NO_INTS: Ints = np.empty(0, np.int64)


@dataclass(frozen=True)
class Decoded:
    """A batch, its sequence, and how its sender calls the time of a step."""

    sequence: int
    batch: Batch
    time_path: Callable[[int], str]


def decode(content_type: str, body: bytes, config: MapConfig) -> Decoded:
    """Return the measurements in a body of one of the two content types.

    Raises ``Problem``: 400, 415 or 422.
    """

    def hint(error: Mapping[str, Any]) -> str | None:
        inside = len(error["loc"]) > 1 and error["type"] in ("missing", "extra_forbidden")
        return _expected(config) if inside else None

    if content_type == COLUMNS_TYPE:
        columns = parse(_COLUMNS, body, hint)
        return Decoded(columns.sequence, from_columns(columns, config), "t.{}".format)
    rows = parse(_ROWS[config.observation.model], body, hint)
    return Decoded(rows.sequence, from_rows(rows, config), "steps.{}.t".format)


def _expected(config: MapConfig) -> str:
    motion, seen = config.motion, config.observation
    return (
        f"this map's motion model is {motion.model} ({', '.join(motion.channels)}) and its "
        f"observations are {seen.model} ({', '.join(seen.channels)})"
    )


# -- columns -------------------------------------------------------------------------------------


def from_columns(columns: Columns, config: MapConfig) -> Batch:
    """Return columns as a batch; raises ``Problem`` (422)."""
    t = np.array(columns.t)
    control_step, control = _control_columns(columns, config, t.size)
    covariance = _matrices("control_covariance", columns.control_covariance, 3, control_step.size)
    if covariance is not None and config.motion.model != "odometry":
        raise invalid("control_covariance", f"only an odometry may carry one; {_expected(config)}")
    seen = columns.observation
    if seen is None:
        seen = ObservationColumns.model_construct(step=[], landmark=[], z=[[], []], covariance=None)
    step = np.array(seen.step, dtype=np.int64)
    _check_steps("observation.step", step, t.size, least_rise=0)
    if len(seen.landmark) != step.size:
        raise invalid(
            "observation.landmark",
            f"got {len(seen.landmark)}, expected one for each of {step.size} entries of observation.step",
        )
    z = _channels("observation.z", seen.z, config.observation.channels, step.size)
    if config.observation.model == "range_bearing":
        _check(z[0] > 0.0, lambda i: f"observation.z.0.{i}", z[0], "a range above 0")
    batch = Batch(
        t=t,
        control_step=control_step,
        control=control,
        control_covariance=covariance,
        observation_step=step,
        landmark=tuple(seen.landmark),
        z=z,
        observation_covariance=_matrices("observation.covariance", seen.covariance, 2, step.size),
    )
    check_times(batch, "t.{}".format)
    return batch


def _control_columns(columns: Columns, config: MapConfig, steps: int) -> tuple[Ints, Floats]:
    if columns.control is None:
        for name in ("control_step", "control_covariance"):
            if getattr(columns, name) is not None:
                raise invalid(name, "given without control")
        return _NO_INTS, np.empty((len(config.motion.channels), 0))
    if columns.control_step is None:
        step = np.arange(steps, dtype=np.int64)
    else:
        step = np.array(columns.control_step, dtype=np.int64)
        _check_steps("control_step", step, steps, least_rise=1)
    return step, _channels("control", columns.control, config.motion.channels, step.size)


def _check_steps(name: str, step: Ints, steps: int, *, least_rise: int) -> None:
    _check(step < steps, lambda i: f"{name}.{i}", step, f"a step from 0 to {steps - 1}")
    rises = np.diff(step, prepend=-1) >= least_rise
    order = "rising" if least_rise else "not falling"
    _check(rises, lambda i: f"{name}.{i}", step, f"steps in order, {order}")


def _channels(name: str, rows: list[list[float]], channels: tuple[str, ...], width: int) -> Floats:
    if len(rows) != len(channels):
        expected = f"{len(channels)}: {', '.join(channels)}"
        raise invalid(name, f"got {len(rows)} lists, expected {expected}")
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
        _check_square(f"{name}.{i}", matrix, size)
    matrices = np.array(rows, dtype=np.float64).reshape(count, size, size)
    return check_covariances(matrices, lambda i: f"{name}.{i}")


def _check_square(path: str, matrix: list[list[float]], size: int) -> None:
    if len(matrix) != size or any(len(row) != size for row in matrix):
        raise invalid(path, f"got {shown(matrix)}, expected {size} lists of {size} numbers")


# -- rows ----------------------------------------------------------------------------------------


def from_rows(rows: CartesianRows | RangeBearingRows, config: MapConfig) -> Batch:
    """Return rows as a batch; raises ``Problem`` (422)."""
    steps: list[CartesianStep | RangeBearingStep] = [*rows.steps]
    control_step, control, control_covariance = _control_rows(steps, config)
    seen: list[CartesianObservation | RangeBearingObservation] = []
    step: list[int] = []
    for index, one in enumerate(steps):
        seen += one.observations
        step += [index] * len(one.observations)
    observation_step = np.array(step, dtype=np.int64)
    first = np.searchsorted(observation_step, observation_step)
    channels = [[getattr(o, name) for o in seen] for name in config.observation.channels]

    def covariance_path(i: int) -> str:
        return f"steps.{step[i]}.observations.{i - first[i]}.covariance"

    batch = Batch(
        t=np.array([one.t for one in steps]),
        control_step=control_step,
        control=control,
        control_covariance=control_covariance,
        observation_step=observation_step,
        landmark=tuple(o.landmark for o in seen),
        z=np.array(channels, dtype=np.float64).reshape(2, len(seen)),
        observation_covariance=_filled([o.covariance for o in seen], config.observation.sigma, covariance_path),
    )
    check_times(batch, "steps.{}.t".format)
    return batch


def _control_rows(
    steps: Sequence[CartesianStep | RangeBearingStep], config: MapConfig
) -> tuple[Ints, Floats, Floats | None]:
    model, channels = config.motion.model, config.motion.channels
    other = "velocity" if model == "odometry" else "odometry"
    where: list[int] = []
    controls: list[Any] = []
    for index, step in enumerate(steps):
        if getattr(step, other) is not None:
            raise invalid(f"steps.{index}.{other}", f"does not fit; {_expected(config)}")
        control = getattr(step, model)
        if control is not None:
            where.append(index)
            controls.append(control)
    values = np.array([[getattr(c, name) for c in controls] for name in channels], dtype=np.float64)
    covariance = None
    if model == "odometry":
        given = [c.covariance for c in controls if isinstance(c, Odometry)]
        covariance = _filled(given, config.motion.sigma, lambda i: f"steps.{where[i]}.odometry.covariance")
    return np.array(where, dtype=np.int64), values.reshape(len(channels), len(where)), covariance


def _filled(
    given: list[list[list[float]] | None], sigma: tuple[float, ...], path: Callable[[int], str]
) -> Floats | None:
    """Return the covariances given, the model's own for the rest; None where none is given."""
    where = [i for i, matrix in enumerate(given) if matrix is not None]
    if not where:
        return None
    for i in where:
        _check_square(path(i), given[i] or [], len(sigma))
    own = check_covariances(np.array([given[i] for i in where]), lambda i: path(where[i]))
    filled = np.tile(np.diag(np.square(sigma)), (len(given), 1, 1))
    filled[where] = own
    return filled


# -- both ----------------------------------------------------------------------------------------


def check_times(batch: Batch, path: Callable[[int], str]) -> None:
    """Check that time rises inside a batch; raises ``Problem`` (422)."""
    rise = np.diff(batch.t)
    moves = np.zeros(batch.steps, dtype=bool)
    moves[batch.control_step] = True
    late = np.concatenate([[True], np.where(moves[1:], rise > 0.0, rise >= 0.0)])
    _check(late, path, batch.t, "a time after the step before (equal only without a control)")


def check_covariances(matrices: Floats, path: Callable[[int], str]) -> Floats:
    """Return covariances (n, d, d), symmetric to the last bit.

    Raises ``Problem`` (422) where one is not symmetric and positive definite.
    """
    size = matrices.shape[-1]
    scale = np.sqrt(np.abs(np.einsum("nii->ni", matrices)))
    skew = np.abs(matrices - matrices.transpose(0, 2, 1))
    symmetric = np.all(skew <= SYMMETRIC * scale[:, :, None] * scale[:, None, :], axis=(1, 2))
    _check(symmetric, path, matrices, "a symmetric matrix")
    matrices = 0.5 * (matrices + matrices.transpose(0, 2, 1))
    rest = matrices.copy()
    positive = np.all(np.einsum("nii->ni", matrices) >= LEAST_VARIANCE, axis=1)
    for k in range(size):  # Gaussian elimination of all at once: each pivot has to stay positive
        pivot = rest[:, k, k]
        positive &= pivot > PIVOT * matrices[:, k, k]
        safe = np.where(positive, pivot, 1.0)
        rest -= rest[:, :, k, None] * rest[:, None, k, :] / safe[:, None, None]
    _check(positive, path, matrices, "a positive definite matrix")
    return matrices


def _check(good: NDArray[np.bool_], path: Callable[[int], str], values: NDArray[Any], expected: str) -> None:
    if not good.all():
        first = int(np.argmin(good))
        raise _refused(path(first), values[first], expected)


def _refused(path: str, value: Any, expected: str) -> Problem:
    return invalid(path, f"got {shown(value.tolist())}, expected {expected}")
