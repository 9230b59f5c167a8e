"""What goes into a map and what comes back: columns of one robot's measurements, and a report."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_ENCOUNTER = "\x1f"  # not printable: no landmark's id can hold it


def encounter(robot: str, t: float) -> str:
    """The name under which a sighting of another robot, at time t (s), stands among the landmarks.

    The other robot's position at that moment is a point like any landmark, held by both robots'
    sub-maps.
    """
    return f"{_ENCOUNTER}{robot}{_ENCOUNTER}{float(t)!r}"


def as_encounter(name: str) -> tuple[str, float] | None:
    """The robot and time (s) of an encounter's name, ``None`` for a landmark's."""
    if not name.startswith(_ENCOUNTER):
        return None
    _, robot, t = name.split(_ENCOUNTER)
    return robot, float(t)


@dataclass(frozen=True)
class Batch:
    """Steps of one robot as columns, already validated.

    ``t`` (n,) seconds; ``control`` (d, c) with ``control_step`` (c,) strictly rising;
    ``z`` (channels, m) with ``observation_step`` (m,) not falling and ``landmark`` m ids. Covariances
    (c, d, d) and (m, channels, channels) stand where the client sent its own, and are ``None`` where the model's
    sigma holds throughout; a row of ``control_covariance`` that is NaN at [0, 0] means the model's own
    noise as well. A sighting of another robot is an observation of the landmark that
    ``encounter`` names; within a step it follows those of landmarks. Where landmarks are not known
    their ids are empty.
    """

    t: Floats
    control_step: Ints
    control: Floats
    control_covariance: Floats | None
    observation_step: Ints
    landmark: tuple[str, ...]
    z: Floats
    observation_covariance: Floats | None

    @property
    def steps(self) -> int:
        """Number of steps."""
        return int(self.t.shape[0])

    @property
    def observations(self) -> int:
        """Number of observations."""
        return int(self.observation_step.shape[0])


@dataclass(frozen=True)
class Rejection:
    """An observation that was not used (or, in ``flagged``, one that is used but unlikely).

    ``observation`` counts within its step. ``nis`` is the normalised innovation squared, or
    ``None`` where none could be formed.
    """

    step: int
    observation: int
    landmark: str
    reason: str
    nis: float | None


@dataclass(frozen=True)
class Report:
    """What applying a batch did: the robot's pose after it, and what was set aside.

    ``pose`` (x m, y m, theta rad; in space x, y, z m and a rotation vector, rad) is in the frame of
    ``submap``; ``track_pose`` (n, pose) after each step in the frame of ``track_submap`` (n,), ``track_odom``
    (n, pose) by dead reckoning in ``odom``.
    Where landmarks are not known, ``found`` tells that of each observation, ``None`` if it was ambiguous;
    encounters are left out.
    """

    submap: int
    t: float
    pose: tuple[float, ...]
    rejected: tuple[Rejection, ...]
    flagged: tuple[Rejection, ...]
    track_submap: NDArray[np.int32]
    track_pose: Floats
    track_odom: Floats
    found: tuple[str | None, ...] | None = None
