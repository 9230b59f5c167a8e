"""Mean and covariance of pose, map and measurement before the measurement counts: EKF and UKF (eqs 15 to 17, 19, 20).

A view is split in two. What it says of its pose, Hₓᵀ R⁻¹ z, makes the pose given the map: x̂ − A δm
with its own covariance (HₓᵀR⁻¹Hₓ)⁻¹. What is left is orthogonal to that and is what the update uses,
for the pose's sigma points follow the map's so that Hₓᵀ R⁻¹ sees none of it. On a linear world this
is the exact posterior under a flat prior on the pose, for the EKF as for the second and third UKF.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from submaps.filtering.unscented import Scaling, Weights, mean_of, offsets
from submaps.nonodometry.belief import Belief, Status, View
from submaps.nonodometry.poses import Poses
from submaps.nonodometry.sensor import Sensor
from submaps.nonodometry.sigma_poses import SigmaPoses

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Moments:
    """Of pose, map (6 + 3n) and the whitened measurement (dk), before the measurement.

    ``covariance`` (6 + 3n, 6 + 3n), ``with_measured`` (6 + 3n, dk), ``innovation`` z − ẑ and its
    ``spread`` (dk, dk) = S, noise included.
    """

    pose: Poses
    covariance: Floats
    with_measured: Floats
    innovation: Floats
    spread: Floats


Filter = Callable[[Sensor, Belief, View], Moments | Status]


def extended(sensor: Sensor, belief: Belief, view: View) -> Moments:
    """The EKF: the moments of the linearised view, with the pose moved along by −A δm (eq. 24)."""
    P, A = belief.covariance, view.correction
    AP = A @ P
    covariance = _joint(AP @ A.T + view.own, -AP, P)
    G = view.by_map - view.by_pose @ A
    PG = P @ G.T
    spread = np.eye(len(G)) + G @ PG
    return Moments(view.pose, covariance, np.vstack([-A @ PG, PG]), view.residual, spread)


@dataclass(frozen=True)
class Unscented:
    """The UKF: moments of sigma points of the map, each with a pose that ``poses`` finds for it."""

    poses: SigmaPoses
    scaling: Scaling = field(default_factory=Scaling)

    def __call__(self, sensor: Sensor, belief: Belief, view: View) -> Moments | Status:
        """Equations 15 to 17 and 20, and the covariance that eq. 19 subtracts from."""
        weight = self.scaling.weights(len(belief.covariance))
        xi = offsets(belief.covariance, weight.spread)
        if xi is None:
            return Status.not_positive
        points = (belief.points + xi.reshape(len(xi), -1, 3))[:, view.seen]
        poses = self.poses(sensor, view, points, xi)
        if poses is None:
            return Status.no_sigma_pose
        y = poses.to_body(points)
        if not np.all(sensor.sees(y)):
            return Status.no_sigma_pose
        measured = (sensor.observe(y) / sensor.sigma[:, np.newaxis]).reshape(len(y), -1)
        return _moments(belief, view, xi, poses, measured, weight)


def _moments(belief: Belief, view: View, xi: Floats, poses: Poses, measured: Floats, weight: Weights) -> Moments:
    pose = mean_of(poses, view.pose, weight.mean, Poses.retract, Poses.minus)
    apart = measured - measured[0]  # from the centre, for the weights cancel what is common
    bias = weight.mean @ apart
    error = np.hstack([poses.minus(pose), xi])
    deviation = apart - bias
    weighted = error.T * weight.covariance
    with_pose = weighted[:6] @ error
    covariance = _joint(with_pose[:, :6] + view.own, with_pose[:, 6:], belief.covariance)  # what xi adds up to
    spread = np.eye(len(bias)) + (deviation.T * weight.covariance) @ deviation
    return Moments(pose, covariance, weighted @ deviation, view.residual - bias, spread)


def _joint(pose: Floats, with_map: Floats, points: Floats) -> Floats:
    """The covariance (6 + 3n, 6 + 3n) of pose and map from its blocks."""
    whole = np.empty((6 + len(points), 6 + len(points)))
    whole[:6, :6], whole[:6, 6:], whole[6:, :6], whole[6:, 6:] = pose, with_map, with_map.T, points
    return whole
