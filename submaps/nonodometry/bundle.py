"""Points and poses of maximum likelihood from some views together: bundle adjustment.

Views alone leave seven things open, the frame and the scale. They are held by the first pose, which
stays as given, and by the distance from the first camera to the last. What is left has one optimum
with a regular information, and eliminating the poses leaves the points' information
Σ H_mᵀ(I − Hₓ(HₓᵀHₓ)⁻¹Hₓᵀ)H_m (whitened), whose inverse is their covariance given that gauge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from submaps.filtering.unscented import cholesky
from submaps.nonodometry.belief import Belief
from submaps.nonodometry.likelihood import linearise
from submaps.nonodometry.poses import Poses, exp
from submaps.nonodometry.sensor import Sensor

Floats = NDArray[np.float64]

_DECREMENT = 1e-10  # a step this long, squared, in standard deviations, is the last
_LEAST, _FIRST, _MOST = 1e-12, 1e-4, 1e8


@dataclass(frozen=True)
class Bundle:
    """Points with their covariance, poses (n), Σ‖z − h‖²_R, and whether the optimum was found."""

    belief: Belief
    poses: Poses
    cost: float
    found: bool


@dataclass(frozen=True)
class _Reduced:
    """Normal equations with the poses eliminated, and what gives the poses' step back."""

    information: Floats  # (3k, 3k) of the points
    gradient: Floats  # (3k,)
    basis: Floats  # (n - 1, 6, 6) directions that a pose may move in, the last one's sixth 0
    own: Floats  # (n - 1, 6, 6) inverses of the poses' blocks along them
    cross: Floats  # (n - 1, 6, 3k)
    pose_gradient: Floats  # (n - 1, 6)


def adjust(sensor: Sensor, z: Floats, points: Floats, poses: Poses, rounds: int = 100) -> Bundle:
    """Levenberg–Marquardt over points (k, 3) and poses (n) for views z (n, k, d), n at least 2.

    The first pose and the distance from the first position to the last are what they are in ``poses``.
    """
    damping, cost = _LEAST, _cost(sensor, z, points, poses)
    found = False
    for _ in range(rounds):
        system = _reduce(sensor, z, points, poses, damping)
        factor = cholesky(system.information)
        if factor is None:
            damping = max(10.0 * damping, _FIRST)
        else:
            step: Floats = np.linalg.solve(system.information, system.gradient).astype(np.float64)
            moved, turned = _move(system, step, points, poses)
            after = _cost(sensor, z, moved, turned)
            last = float(step @ system.information @ step) < _DECREMENT * len(step) and np.isfinite(after)
            if after <= cost or last:
                points, poses, cost, damping = moved, turned, after, max(0.1 * damping, _LEAST)
                if last:
                    found = True
                    break
            else:
                damping = max(10.0 * damping, _FIRST)
        if damping > _MOST:
            break
    information = _reduce(sensor, z, points, poses, 0.0).information
    found = found and cholesky(information) is not None
    covariance = np.linalg.inv(information) if found else np.full_like(information, np.nan)
    return Bundle(Belief(points, 0.5 * (covariance + covariance.T)), poses, cost, found)


def _reduce(sensor: Sensor, z: Floats, points: Floats, poses: Poses, damping: float) -> _Reduced:
    count, k, d = z.shape
    view = linearise(sensor, poses, np.broadcast_to(points, (count, k, 3)), z)
    H = view.by_point.reshape(count, d, k, 3)
    residual = view.residual.reshape(count, d, k)
    diagonal = np.einsum("jdki,jdkl->kil", H, H)
    information = np.zeros((k, 3, k, 3))
    information[np.arange(k), :, np.arange(k)] = diagonal * (1.0 + damping * np.eye(3))
    basis = np.tile(np.eye(6), (count - 1, 1, 1))
    basis[-1] = _last_basis(poses)
    Hx = view.by_pose[1:] @ basis
    transposed = np.swapaxes(Hx, -1, -2)
    normal = transposed @ Hx
    normal *= 1.0 + damping * np.eye(6)
    normal[-1, 5, 5] += 1.0  # the direction that is not there
    own = np.linalg.inv(normal).astype(np.float64)
    cross = np.einsum("jdkp,jdki->jpki", Hx.reshape(count - 1, d, k, 6), H[1:]).reshape(count - 1, 6, 3 * k)
    pose_gradient = (transposed @ view.residual[1:, :, np.newaxis])[..., 0]
    gradient = np.einsum("jdki,jdk->ki", H, residual).ravel()
    folded = own @ cross
    reduced = information.reshape(3 * k, 3 * k) - np.einsum("jpa,jpb->ab", cross, folded, optimize=True)
    gradient = gradient - np.einsum("jpa,jp->a", folded, pose_gradient)
    return _Reduced(0.5 * (reduced + reduced.T), gradient, basis, own, cross, pose_gradient)


def _last_basis(poses: Poses) -> Floats:
    """Directions (6, 6) of the last pose that keep its distance from the first: two across, three to turn, and 0."""
    along = poses.position[-1] - poses.position[0]
    across = np.linalg.svd(along[np.newaxis])[2][1:]
    basis = np.zeros((6, 6))
    basis[:3, :2] = across.T
    basis[3:, 2:5] = np.eye(3)
    return basis


def _move(system: _Reduced, step: Floats, points: Floats, poses: Poses) -> tuple[Floats, Poses]:
    local = (system.own @ (system.pose_gradient - system.cross @ step)[..., np.newaxis])[..., 0]
    xi = (system.basis @ local[..., np.newaxis])[..., 0]
    position, rotation = poses.position.copy(), poses.rotation.copy()
    position[1:] += xi[:, :3]
    rotation[1:] = exp(xi[:, 3:]) @ rotation[1:]
    along = position[-1] - position[0]
    baseline = np.linalg.norm(poses.position[-1] - poses.position[0])
    position[-1] = position[0] + along * (baseline / np.linalg.norm(along))
    return points + step.reshape(-1, 3), Poses(rotation, position)


def _cost(sensor: Sensor, z: Floats, points: Floats, poses: Poses) -> float:
    y = poses.to_body(np.broadcast_to(points, (len(z), *points.shape)))
    if not np.all(sensor.sees(y)):
        return float("inf")
    residual = (np.swapaxes(z, -1, -2) - sensor.observe(y)) / sensor.sigma[:, np.newaxis]
    return float(np.sum(residual * residual))
