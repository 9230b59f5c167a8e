"""The plane and space as values: what differs between two dimensions and three, in one place.

A pose is ``dim`` numbers of position (m) and ``rot`` of rotation (rad: the heading, or a rotation
vector). Its error has the same order: additive in position, and about the outer frame's axes in rotation,
R = exp(e_theta) R^. ``turn(p)`` (dim, rot) is the velocity of a point p when its frame turns: exp(e) p = p +
turn(p) e; J p in the plane, -S(p) in space.

Compiled code takes ``Space.key``, a tuple of as many zeros as there are dimensions: its length is part of its
type, so each dimension gets machine code of its own from one source, with loops of known length.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.geometry import se2, se3, so3
from submaps.geometry.trig import arctan2, rotation_series, sincos

Floats = NDArray[np.float64]
Pose = tuple[float, ...]
Key = tuple[int, ...]


@jit(
    "void(UniTuple(int64, 2), float64[:], float64[:, :])",
    "void(UniTuple(int64, 3), float64[:], float64[:, :])",
)
def fill_rotation(space: Key, angles: Floats, out: Floats) -> None:
    """The rotation matrix (dim, dim) of a heading (1,) or rotation vector (3,), into ``out``."""
    if len(space) == 2:
        s, c = sincos(angles[0])
        out[0, 0], out[0, 1], out[1, 0], out[1, 1] = c, -s, s, c
    else:
        so3.matrix(angles[0], angles[1], angles[2], out)


@jit(
    "void(UniTuple(int64, 2), float64[:], float64[:, :])",
    "void(UniTuple(int64, 3), float64[:], float64[:, :])",
)
def fill_left_jacobian(space: Key, angles: Floats, out: Floats) -> None:
    """V (dim, dim) of a heading (1,) or rotation vector (3,): what a retraction carries points by; into ``out``."""
    if len(space) == 2:
        a, b = rotation_series(angles[0])
        out[0, 0], out[0, 1], out[1, 0], out[1, 1] = a, -b, b, a
    else:
        so3.left_jacobian(angles[0], angles[1], angles[2], out)


class Space:
    """One of ``PLANE`` and ``SOLID``; poses are tuples of ``pose`` numbers, matrices NumPy arrays."""

    def __init__(self, name: str, dim: int, rot: int, group: Any) -> None:
        self.name = name
        self.dim = dim
        self.rot = rot
        self.pose = dim + rot
        self.key: Key = (0,) * dim
        self.origin: Pose = (0.0,) * self.pose
        self._group = group

    def as_pose(self, values: Floats | Sequence[float]) -> Pose:
        """A pose from an array (pose,)."""
        return tuple(float(v) for v in values[: self.pose])

    def compose(self, a: Pose, b: Pose) -> Pose:
        """T_a_c = T_a_b T_b_c."""
        composed: Pose = self._group.compose(a, b)
        return composed

    def inverse(self, a: Pose) -> Pose:
        """T_b_a from T_a_b."""
        inverted: Pose = self._group.inverse(a)
        return inverted

    def between(self, a: Pose, b: Pose) -> Pose:
        """T_a_b of two poses given in one frame."""
        relative: Pose = self._group.between(a, b)
        return relative

    def exp(self, xi: Pose) -> Pose:
        """The pose reached by a tangent (position, rotation)."""
        pose: Pose = self._group.exp(xi)
        return pose

    def log(self, pose: Pose) -> Pose:
        """The tangent (position, rotation) that reaches a pose."""
        xi: Pose = self._group.log(pose)
        return xi

    def transform(self, a: Pose, point: Floats) -> Floats:
        """A point (dim,), or points (n, dim), in the frame of ``a``, in the frame that ``a`` is given in."""
        return np.asarray(np.asarray(point) @ self.rotation(a).T + np.array(a[: self.dim]))

    def rotation(self, pose: Pose | Floats) -> Floats:
        """(dim, dim) rotation matrix of a pose."""
        return self.rotation_of(pose[self.dim :])

    def rotation_of(self, angles: Sequence[float] | Floats) -> Floats:
        """(dim, dim) rotation matrix of a heading (1,) or a rotation vector (3,)."""
        out = np.empty((self.dim, self.dim))
        fill_rotation(self.key, np.asarray(angles, dtype=np.float64), out)
        return out

    def left_jacobian(self, angles: Sequence[float] | Floats) -> Floats:
        """V (dim, dim) of a heading (1,) or a rotation vector (3,)."""
        out = np.empty((self.dim, self.dim))
        fill_left_jacobian(self.key, np.asarray(angles, dtype=np.float64), out)
        return out

    def angles_of(self, R: Floats) -> Floats:
        """The heading (1,) or rotation vector (3,) of a rotation matrix (dim, dim)."""
        if self.dim == 2:
            return np.array([arctan2(R[1, 0], R[0, 0])])
        return np.array(so3.rotation_vector(so3.quaternion_of(np.ascontiguousarray(R))))

    def turn(self, point: Floats) -> Floats:
        """(dim, rot) matrix with exp(e) p = p + turn(p) e to first order: J p, or -S(p)."""
        if self.dim == 2:
            return np.array([[-point[1]], [point[0]]])
        x, y, z = point
        return np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])

    def _turned(self, R: Floats) -> Floats:
        """(pose, pose) matrix that rotates a pose's error: diag(R, 1) in the plane, diag(R, R) in space."""
        out = np.eye(self.pose)
        out[: self.dim, : self.dim] = R
        if self.dim == 3:
            out[3:, 3:] = R
        return out

    def compose_covariance(self, a: Pose, cov_a: Floats, b: Pose, cov_b: Floats) -> Floats:
        """(pose, pose) covariance of a composed with an independent b (Smith, Self, Cheeseman 1990).

        d(a b)/da = [[I, turn(R_a p_b)], [0, I]], d(a b)/db = diag(R_a, 1) in the plane, diag(R_a, R_a) in space.
        """
        R = self.rotation(a)
        by_a = np.eye(self.pose)
        by_a[: self.dim, self.dim :] = self.turn(R @ np.array(b[: self.dim]))
        by_b = self._turned(R)
        return np.asarray(by_a @ cov_a @ by_a.T + by_b @ cov_b @ by_b.T)

    def inverse_covariance(self, a: Pose, cov_a: Floats) -> Floats:
        """(pose, pose) covariance of the inverse of a pose."""
        R = self.rotation(a)
        by_a = -self._turned(R.T)
        if self.dim == 2:
            by_a[2, 2] = -1.0
        by_a[: self.dim, self.dim :] = R.T @ self.turn(np.array(a[: self.dim]))
        return np.asarray(by_a @ cov_a @ by_a.T)


PLANE = Space("se2", 2, 1, se2)
SOLID = Space("se3", 3, 3, se3)
SPACES = {space.name: space for space in (PLANE, SOLID)}
