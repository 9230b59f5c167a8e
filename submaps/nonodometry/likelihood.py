"""The pose of maximum likelihood: what a view says of its own pose, given the points (eqs 21 and 25).

ℓ(x | z, m) = −½ Σ ‖zᵢ − h(Rᵀ(mᵢ − p))‖²_R over the points of the view, by Levenberg–Marquardt on SE(3) for
many maps at once: the sigma points of one view are as many problems as there are maps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from submaps.nonodometry.poses import Poses, exp
from submaps.nonodometry.sensor import Sensor

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

_DECREMENT = 1e-6  # a step this long, squared, in standard deviations of the pose, is the last
_LEAST, _FIRST, _MOST = 1e-12, 1e-4, 1e8  # relative damping: always there, at the first refusal, given up


@dataclass(frozen=True)
class Fit:
    """Poses (B), and whether each is an optimum (B,)."""

    poses: Poses
    found: Bools


@dataclass(frozen=True)
class Linearised:
    """B views about their poses and the map, whitened by R^(-1/2); first components of all points come first.

    ``residual`` (B, dn) is z − h, ``by_pose`` (B, dn, 6) is Hₓ, ``by_point`` (B, dn, 3) the block of H_m
    that belongs to each row's point; tangents are along the map's axes.
    """

    residual: Floats
    by_pose: Floats
    by_point: Floats


@dataclass
class _Problems:
    """B views of n points each: where their poses stand, and what is left of the measurements there.

    ``y`` (B, 3, n) are the points in the body frame, ``residual`` (B, d, n) is R^(-1/2)(z − h), ``cost``
    (B,) its square, infinite where a point is not where it could be seen.
    """

    poses: Poses
    y: Floats
    residual: Floats
    cost: Floats

    def take(self, index: Bools) -> _Problems:
        return _Problems(self.poses.take(index), self.y[index], self.residual[index], self.cost[index])

    def put(self, index: Bools, other: _Problems) -> None:
        self.poses.rotation[index] = other.poses.rotation[index]
        self.poses.position[index] = other.poses.position[index]
        self.y[index], self.residual[index], self.cost[index] = (
            other.y[index], other.residual[index], other.cost[index],
        )  # fmt: skip


def maximum_likelihood(sensor: Sensor, points: Floats, z: Floats, start: Poses, rounds: int = 30) -> Fit:
    """The poses (B) that make z (n, d) most likely for each of B maps (B, n, 3), from ``start`` (B).

    An optimum that is not reached in ``rounds``, or from which a point cannot be seen, is not found.
    Fewer points than a pose needs are not noticed here: the information is then singular.
    """
    seen = np.ascontiguousarray(z.T)
    here = _at(sensor, points, seen, Poses(np.array(start.rotation), np.array(start.position)))
    count = len(points)
    poses = Poses(here.poses.rotation.copy(), here.poses.position.copy())
    found = np.zeros(count, dtype=np.bool_)
    left, damping = np.arange(count), np.full(count, _LEAST)
    for _ in range(rounds):
        normal, gradient = _normal_equations(sensor, here)
        step, decrement = _steps(normal, gradient, damping)
        there = _at(sensor, points[left], seen, _moved(here.poses, step))
        last = (decrement < _DECREMENT) & np.isfinite(there.cost)  # so short a step may rise by rounding
        better = (there.cost <= here.cost) | last
        if better.all():
            here = there
        else:
            here.put(better, there)
        damping = np.where(better, np.maximum(0.1 * damping, _LEAST), np.maximum(10.0 * damping, _FIRST))
        over = (last & better) | (damping > _MOST)
        if over.any():
            ended = left[over]
            poses.rotation[ended], poses.position[ended] = here.poses.rotation[over], here.poses.position[over]
            found[ended] = (last & better)[over]
            left, damping, here = left[~over], damping[~over], here.take(~over)
            if not len(left):
                break
    return Fit(poses, found)


def linearise(sensor: Sensor, poses: Poses, points: Floats, z: Floats) -> Linearised:
    """Views z (B, n, d) of points (B, n, 3): dh/dm = dh/dy Rᵀ, dh/dp = −dh/dm, dh/dθ = dh/dm S(m − p)."""
    y = poses.to_body(points)
    jacobian = sensor.jacobian(y) / sensor.sigma[:, np.newaxis, np.newaxis]
    count, d, _, n = jacobian.shape
    by_body = np.moveaxis(_by_pose(jacobian, y, np.empty((count, d, 6, n))), 2, 3).reshape(count, 2 * d * n, 3)
    by_pose = (by_body @ np.swapaxes(poses.rotation, -1, -2)).reshape(count, d * n, 6)
    residual = (np.swapaxes(z, -1, -2) - sensor.observe(y)) / sensor.sigma[:, np.newaxis]
    return Linearised(residual.reshape(count, d * n), by_pose, -by_pose[..., :3])


def _by_pose(jacobian: Floats, y: Floats, out: Floats) -> Floats:
    """[−dh/dy, dh/dy S(y)] (..., d, 6, n): dh by the pose's motion along the body's own axes."""
    np.negative(jacobian, out=out[..., :3, :])
    a, b, c = (jacobian[..., k, :] for k in range(3))
    u, v, w = (y[..., np.newaxis, k, :] for k in range(3))
    out[..., 3, :], out[..., 4, :], out[..., 5, :] = b * w - c * v, c * u - a * w, a * v - b * u
    return out


def _at(sensor: Sensor, points: Floats, seen: Floats, poses: Poses) -> _Problems:
    y = poses.to_body(points)
    visible = np.all(sensor.sees(y), axis=-1)
    if not visible.all():
        y[~visible] = 1.0  # anywhere that h is defined; the cost says that it is not there
    residual = (seen - sensor.observe(y)) / sensor.sigma[:, np.newaxis]
    cost = np.einsum("bdn,bdn->b", residual, residual)
    return _Problems(poses, y, residual, np.where(visible & np.isfinite(cost), cost, np.inf))


def _normal_equations(sensor: Sensor, here: _Problems) -> tuple[Floats, Floats]:
    """HₓᵀR⁻¹Hₓ (B, 6, 6) and HₓᵀR⁻¹(z − h) (B, 6), along the body's axes: blocks of one product with itself."""
    jacobian = sensor.jacobian(here.y) / sensor.sigma[:, np.newaxis, np.newaxis]
    count, d, _, n = jacobian.shape
    rows = np.empty((count, d, 7, n))
    _by_pose(jacobian, here.y, out=rows[:, :, :6])
    rows[:, :, 6] = here.residual
    product = rows[:, 0] @ np.swapaxes(rows[:, 0], -1, -2)
    for k in range(1, d):
        product += rows[:, k] @ np.swapaxes(rows[:, k], -1, -2)
    return product[:, :6, :6], product[:, :6, 6]


def _steps(normal: Floats, gradient: Floats, damping: Floats) -> tuple[Floats, Floats]:
    """Damped steps (B, 6), and their squared lengths (B,) in standard deviations of the pose."""
    damped = normal.copy()
    diagonal = damped.reshape(-1, 36)[:, ::7]
    floor = 1e-14 * diagonal.sum(axis=-1, keepdims=True) + np.finfo(np.float64).tiny
    diagonal += damping[:, np.newaxis] * diagonal + floor
    step = np.asarray(np.linalg.solve(damped, gradient[..., np.newaxis]), dtype=np.float64)
    return step[..., 0], (np.swapaxes(step, -1, -2) @ normal @ step)[:, 0, 0]


def _moved(poses: Poses, step: Floats) -> Poses:
    """p + R δ, R exp(θ): a step along the body's axes."""
    position = poses.position + (poses.rotation @ step[:, :3, np.newaxis])[..., 0]
    return Poses(poses.rotation @ exp(step[:, 3:]), position)
