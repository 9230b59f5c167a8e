"""What a filter needs of the space that its robot is in; the plane, space, and a line.

``geometry.space`` holds PLANE and SOLID. A line, the world of beads, is here: no rotation, and nothing
that is not linear.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Pose = tuple[float, ...]


class Geometry(Protocol):
    """Points (dim,), rotations (rot,), poses of both (pose,)."""

    @property
    def dim(self) -> int:
        """Coordinates of a point."""

    @property
    def rot(self) -> int:
        """Numbers of a rotation."""

    @property
    def pose(self) -> int:
        """Numbers of a pose."""

    def compose(self, a: Pose, b: Pose) -> Pose:
        """T_a_c = T_a_b T_b_c."""

    def rotation_of(self, angles: Floats) -> Floats:
        """R (dim, dim) = exp(angles)."""

    def left_jacobian(self, angles: Floats) -> Floats:
        """V (dim, dim), the mean of exp(s angles) over s in [0, 1]."""

    def turn(self, point: Floats) -> Floats:
        """(dim, rot) matrix with exp(e) p = p + turn(p) e to first order."""


class Line:
    """One dimension and no rotation: the beads' wire."""

    dim, rot, pose = 1, 0, 1

    def compose(self, a: Pose, b: Pose) -> Pose:
        """The sum."""
        return (a[0] + b[0],)

    def rotation_of(self, angles: Floats) -> Floats:
        """The identity: there is nothing to turn."""
        return np.eye(1)

    def left_jacobian(self, angles: Floats) -> Floats:
        """The identity."""
        return np.eye(1)

    def turn(self, point: Floats) -> Floats:
        """No columns."""
        return np.empty((1, 0))


LINE = Line()


def turned(space: Geometry, a: Floats, b: Floats) -> Floats:
    """The rotation exp(a) exp(b), (rot,)."""
    zero = (0.0,) * space.dim
    return np.array(space.compose((*zero, *a.tolist()), (*zero, *b.tolist()))[space.dim :])


def outward(space: Geometry, R: Floats) -> Floats:
    """(rot, rot): a rotation's error in the frame that R turns from, seen from outside: R in space, 1 in the plane."""
    return R if space.rot == 3 else np.eye(space.rot)
