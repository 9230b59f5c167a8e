"""The exponential coordinates in which factors speak, compiled once for the plane and once for space.

A pose is position, then heading or rotation vector; increments are additive in position, and in rotation
about the outer frame's axes, R <- exp(delta) R. ``turn(p)`` is J p in the plane, -S(p) in space: exp(e) p =
p + turn(p) e (see ``geometry.space``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.geometry import so3
from submaps.geometry.small import Matrix, Vector, combined, dot, minus, plus, put_column, scaled, turn, vector
from submaps.geometry.space import Key, Pose, Space
from submaps.geometry.trig import sincos, wrap

Floats = NDArray[np.float64]
_quaternion, _rotation_vector, _multiply = so3.quaternion, so3.rotation_vector, so3.multiply
_matrix, _left_jacobian_inverse, _series = so3.matrix, so3.left_jacobian_inverse, so3.inverse_series


@jit()
def rotation(angles: Vector) -> Matrix:
    """The rotation matrix of a heading or a rotation vector (rad)."""
    if len(angles) == 1:
        s, c = sincos(angles[0])
        return (c, -s), (s, c)
    M = np.empty((3, 3))
    _matrix(angles[0], angles[1], angles[2], M)
    return (M[0, 0], M[0, 1], M[0, 2]), (M[1, 0], M[1, 1], M[1, 2]), (M[2, 0], M[2, 1], M[2, 2])


@jit()
def rotation_error(frame: Vector, end: Vector, estimate: Vector) -> Vector:
    """phi with R_frame^T R_end = exp(phi) R_estimate, from headings or rotation vectors (rad)."""
    if len(frame) == 1:
        return (wrap(end[0] - frame[0] - estimate[0]),)
    local = _multiply(_quaternion(-frame[0], -frame[1], -frame[2]), _quaternion(end[0], end[1], end[2]))
    return _rotation_vector(_multiply(local, _quaternion(-estimate[0], -estimate[1], -estimate[2])))


@jit()
def _plane_series(phi: float) -> tuple[float, float]:
    """alpha = (phi/2) cot(phi/2), with V(phi)^-1 = [[alpha, phi/2], [-phi/2, alpha]], and its slope."""
    if abs(phi) < 0.3:
        z = phi * phi
        alpha = 1.0 - z / 12.0 * (1.0 + z / 60.0 * (1.0 + z / 42.0 * (1.0 + z / 40.0)))
        slope = -phi / 6.0 * (1.0 + z / 30.0 * (1.0 + z / 28.0 * (1.0 + z / 30.0)))
        return alpha, slope
    s, c = sincos(0.5 * phi)
    return 0.5 * phi * c / s, 0.5 * c / s - 0.25 * phi / (s * s)


@jit()
def left_inverse(phi: Vector) -> tuple[Matrix, Vector]:
    """V(phi)^-1 (dim, dim), V the left Jacobian of the rotation, and the series that its slope takes."""
    if len(phi) == 1:
        alpha, slope = _plane_series(phi[0])
        half = 0.5 * phi[0]
        return ((alpha, half), (-half, alpha)), (slope, 0.5)
    M = np.empty((3, 3))
    _left_jacobian_inverse(phi[0], phi[1], phi[2], M)
    rows = (M[0, 0], M[0, 1], M[0, 2]), (M[1, 0], M[1, 1], M[1, 2]), (M[2, 0], M[2, 1], M[2, 2])
    return rows, _series(dot(phi, phi))


@jit()
def left_inverse_slope(phi: Vector, series: Vector, v: Vector) -> Matrix:
    """d(V(phi)^-1 v)/d(phi) at fixed v, its columns; ``series`` as ``left_inverse`` gives it.

    In space V^-1 v = v - phi x v / 2 + g (phi (phi . v) - a^2 v) with g as in ``so3.inverse_series``, so
    its slope is S(v)/2 + g (phi . v I + phi v^T - 2 v phi^T) + (g'/a) (phi (phi . v) - a^2 v) phi^T.
    """
    if len(phi) == 1:
        return ((series[0] * v[0] + series[1] * v[1], -series[1] * v[0] + series[0] * v[1]),)
    g, slope = series
    along = dot(phi, v)
    turned, curved = turn(v), minus(scaled(along, phi), scaled(dot(phi, phi), v))
    tilted = plus(scaled(slope, curved), -2.0 * g, v)
    unit = g * along
    first = plus(plus(scaled(-0.5, turned[0]), g * v[0], phi), phi[0], tilted)
    second = plus(plus(scaled(-0.5, turned[1]), g * v[1], phi), phi[1], tilted)
    third = plus(plus(scaled(-0.5, turned[2]), g * v[2], phi), phi[2], tilted)
    return (first[0] + unit, first[1], first[2]), (second[0], second[1] + unit, second[2]), (
        third[0], third[1], third[2] + unit,
    )  # fmt: skip


@jit()
def carried(columns: Matrix, M: Matrix) -> Matrix:
    """The columns of C M, from those of a map C from a rotation's error, M (dim, dim) in space, 1 in the plane."""
    if len(columns) == 1:
        return columns
    across = (M[0][0], M[1][0], M[2][0]), (M[0][1], M[1][1], M[2][1]), (M[0][2], M[1][2], M[2][2])
    return combined(across[0], columns), combined(across[1], columns), combined(across[2], columns)


@jit()
def retract_one(space: Key, pose: Floats, step: Floats) -> None:
    """Move a pose (pose,) by an increment (pose,), in place."""
    for a in range(len(space)):
        pose[a] += step[a]
    if len(space) == 2:
        pose[2] = wrap(pose[2] + step[2])
    else:
        by, q = _quaternion(step[3], step[4], step[5]), _quaternion(pose[3], pose[4], pose[5])
        pose[3], pose[4], pose[5] = _rotation_vector(_multiply(by, q))


@jit(
    "void(UniTuple(int64, 2), float64[:, ::1], float64[:, ::1])",
    "void(UniTuple(int64, 3), float64[:, ::1], float64[:, ::1])",
)
def retract(space: Key, poses: Floats, steps: Floats) -> None:
    """Move poses (n, pose) by increments (n, pose), in place."""
    for i in range(poses.shape[0]):
        retract_one(space, poses[i], steps[i])


@jit(
    "void(UniTuple(int64, 2), float64[:, ::1], float64[:, ::1])",
    "void(UniTuple(int64, 3), float64[:, ::1], float64[:, ::1])",
)
def _fill_turns(space: Key, points: Floats, out: Floats) -> None:
    for i in range(points.shape[0]):
        columns = turn(vector(space, points[i], 0))
        for j in range(len(columns)):
            put_column(columns[j], out, len(space) * i, j)


def turns(space: Space, points: Floats) -> Floats:
    """turn(p) of points (n, dim), one below the other: (dim n, rot)."""
    out = np.empty((points.size, space.rot))
    _fill_turns(space.key, np.ascontiguousarray(points), out)
    return out


def of_rotation(space: Space, M: Floats) -> Floats:
    """What R or V does to a rotation's error: itself in space, 1 in the plane, where all share one axis."""
    return M if space.rot == space.dim else np.eye(space.rot)


def transformed(space: Space, frame: Pose, by_frame: Floats, point: Floats, by_itself: Floats) -> tuple[Floats, Floats]:
    """A frame's point (dim,) outside, and its covariance from that of the frame and, independent, of itself."""
    R = space.rotation(frame)
    at = R @ point
    A = np.hstack([np.eye(space.dim), space.turn(at)])
    return at + frame[: space.dim], A @ by_frame @ A.T + R @ by_itself @ R.T
