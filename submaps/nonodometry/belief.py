"""What is believed of the points between two views, and what a view makes of it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from submaps.nonodometry.likelihood import linearise
from submaps.nonodometry.poses import Poses
from submaps.nonodometry.sensor import Sensor

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Status(StrEnum):
    """How an update ended. After all but ``done`` the belief is the one before."""

    done = "done"
    no_pose = "no pose of maximum likelihood was found for the view"
    no_sigma_pose = "no pose was found for a sigma point, or it sees a point behind itself"
    not_positive = "a covariance is not positive definite"


@dataclass(frozen=True)
class Belief:
    """Points (n, 3) m and their covariance (3n, 3n) m²: the marginal of eqs 13 and 14."""

    points: Floats
    covariance: Floats


@dataclass(frozen=True)
class View:
    """One view: z (k, d) of the points ``seen`` (k,), about the pose of maximum likelihood (eq. 21).

    ``by_pose`` (dk, 6) and ``by_map`` (dk, 3n) are Hₓ and H_m whitened by R^(-1/2), ``residual`` (dk,)
    is z − h(x̂, m̂) likewise, first components of all points first; ``own`` (6, 6) is (HₓᵀR⁻¹Hₓ)⁻¹.
    """

    z: Floats
    seen: Ints
    pose: Poses
    residual: Floats
    by_pose: Floats
    by_map: Floats
    own: Floats

    @property
    def correction(self) -> Floats:
        """A (6, 3n) of eq. 24: where the map moves by δ, the pose of maximum likelihood moves by −A δ."""
        return self.own @ self.by_pose.T @ self.by_map


@dataclass(frozen=True)
class Update:
    """The belief after a view, the view's pose, their joint covariance, and how it went.

    ``covariance`` (6 + 3n, 6 + 3n) is of (position, rotation vector, points) along the map's axes.
    Where ``status`` is not ``done`` the pose and the covariance are None.
    """

    belief: Belief
    status: Status
    pose: Poses | None = None
    covariance: Floats | None = None


def view_at(sensor: Sensor, belief: Belief, pose: Poses, z: Floats, seen: Ints) -> View | None:
    """The view z about a pose of maximum likelihood and the mean of the map; None where it leaves the pose open."""
    found = linearise(sensor, pose.repeat(1), belief.points[np.newaxis, seen], z[np.newaxis])
    k, d = z.shape
    by_map = np.zeros((d, k, len(belief.points), 3))
    by_map[:, np.arange(k), seen] = found.by_point[0].reshape(d, k, 3)
    by_pose = found.by_pose[0]
    own = _inverse(by_pose.T @ by_pose)
    if own is None:
        return None
    return View(z, seen, pose, found.residual[0], by_pose, by_map.reshape(d * k, -1), own)


def _inverse(information: Floats) -> Floats | None:
    """The covariance of an information (6, 6); None where a direction is not measured, in its own scale."""
    scale = np.sqrt(np.diag(information))
    if not np.all(scale > 0.0):
        return None
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    if values[0] < 1e-12:
        return None
    return np.asarray((vectors / values) @ vectors.T / np.outer(scale, scale))
