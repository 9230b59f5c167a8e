"""What rows and columns have to satisfy alike; a fault is a problem that names its place."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.problems import Problem, invalid
from service.wire.base import LARGEST_TURN, shown
from service.wire.models import SPATIAL
from submaps.config import Models, MotionConfig
from submaps.measurements import Batch
from submaps.motion.limits import STEER_LIMIT, expected_steer, followable

SYMMETRIC = 1e-9  # a covariance may differ from its transpose by this share of its diagonal
PIVOT = 1e-12  # of its diagonal, below which a pivot of a covariance is no longer positive
LEAST_VARIANCE = 1e-12

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
_NAMED = "this map's association is known: each observation names its landmark"
# What the sender calls the entry of a number.
PathOf = Callable[[int], str]


# Channels that are angles which may not be so large that their sine means nothing.
_TURNS = {"odometry3d": (3, 4, 5), "bearing": (0,)}


def expected(models: Models) -> str:
    """Return which models a robot's measurements are of."""
    motion, seen = models.motion, models.observation
    moves = f"this robot's motion model is {motion.model}"
    if motion.channels:
        moves += f" ({', '.join(motion.channels)})"
    return f"{moves} and its observations are {seen.model} ({', '.join(seen.channels)})"


def in_space(models: Models) -> bool:
    """Return whether a robot is one of a map in se3."""
    return models.observation.model in SPATIAL


def check(good: NDArray[np.bool_], path: PathOf, values: NDArray[Any], expected_: str) -> None:
    """Raise ``Problem`` (422) for the first of ``values`` that is not good."""
    if not good.all():
        first = int(np.argmin(good))
        raise _refused(path(first), values[first], expected_)


def _refused(path: str, value: Any, expected_: str) -> Problem:
    return invalid(path, f"got {shown(value.tolist())}, expected {expected_}")


def check_times(batch: Batch, path: PathOf) -> None:
    """Check that time rises inside a batch; raises ``Problem`` (422)."""
    if batch.steps == 1:
        return
    rise = np.diff(batch.t)
    moves = np.zeros(batch.steps, dtype=bool)
    moves[batch.control_step] = True
    late = np.concatenate([[True], np.where(moves[1:], rise > 0.0, rise >= 0.0)])
    check(late, path, batch.t, "a time after the step before (equal only without a control)")


def check_steer(motion: MotionConfig, control: Floats, path: PathOf) -> None:
    """Check that a vehicle can follow controls (d, c); raises ``Problem`` (422)."""
    if motion.model in STEER_LIMIT:
        check(followable(motion, control), path, control[1], expected_steer(motion))


def check_turns(model: str, values: Floats, path: Callable[[int, int], str]) -> None:
    """Check the angles among readings (d, n) of a model; raises ``Problem`` (422).

    ``path`` is of a channel and a reading.
    """
    for channel in _TURNS.get(model, ()):
        small = np.abs(values[channel]) <= LARGEST_TURN
        check(small, partial(path, channel), values[channel], f"an angle within {LARGEST_TURN:g} rad")


def check_others(robot: str, met: Sequence[str], path: PathOf) -> None:
    """Check that a robot meets others only; raises ``Problem`` (422)."""
    if robot in met:
        raise invalid(path(met.index(robot)), f"got {robot!r}, the robot itself, expected another")


def names_of(given: Sequence[str | None], association: str, path: PathOf) -> list[str]:
    """Return the landmarks' ids as a batch has them: empty where the map finds them itself.

    Raises ``Problem`` (422) where one is absent that the map needs, or given that it does not take.
    """
    if association == "known":
        if None in given:
            raise invalid(path(given.index(None)), f"required, but absent; {_NAMED}")
        return [name for name in given if name is not None]
    for i, name in enumerate(given):
        if name is not None:
            raise invalid(path(i), f"got {shown(name)}, expected none; {unnamed(association)}")
    return [""] * len(given)


def unnamed(association: str) -> str:
    """Return why observations come without landmarks."""
    return f"this map's association is {association}: it finds out which landmark an observation is of"


def check_square(path: str, matrix: list[list[float]], size: int) -> None:
    """Check that a list of lists is a square matrix; raises ``Problem`` (422)."""
    if len(matrix) != size or any(len(row) != size for row in matrix):
        raise invalid(path, f"got {shown(matrix)}, expected {size} lists of {size} numbers")


def check_covariances(matrices: Floats, path: PathOf) -> Floats:
    """Return covariances (n, d, d), symmetric to the last bit.

    Raises ``Problem`` (422) where one is not symmetric and positive definite.
    """
    size = matrices.shape[-1]
    scale = np.sqrt(np.abs(np.einsum("nii->ni", matrices)))
    skew = np.abs(matrices - matrices.transpose(0, 2, 1))
    symmetric = np.all(skew <= SYMMETRIC * scale[:, :, None] * scale[:, None, :], axis=(1, 2))
    check(symmetric, path, matrices, "a symmetric matrix")
    matrices = 0.5 * (matrices + matrices.transpose(0, 2, 1))
    rest = matrices.copy()
    positive = np.all(np.einsum("nii->ni", matrices) >= LEAST_VARIANCE, axis=1)
    for k in range(size):  # Gaussian elimination of all at once: each pivot has to stay positive
        pivot = rest[:, k, k]
        positive &= pivot > PIVOT * matrices[:, k, k]
        safe = np.where(positive, pivot, 1.0)
        rest -= rest[:, :, k, None] * rest[:, None, k, :] / safe[:, None, None]
    check(positive, path, matrices, "a positive definite matrix")
    return matrices


def of_sigma(sigma: tuple[float, ...]) -> Floats:
    """Return the covariance (d, d) of a model's own noise."""
    return np.diag(np.square(sigma))
