"""Rigid alignment of two sets of points in the plane or in space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from submaps.geometry import so3
from submaps.geometry.space import PLANE, SOLID, Pose, Space

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Alignment:
    """The motion that takes the first points onto the second, and what is left.

    ``pose`` is (x m, y m, theta rad), in space (x, y, z m and a rotation vector, rad). ``rmse`` (m) is
    the root mean square distance after the motion, ``rmse_before`` without it.
    """

    pose: Pose
    rmse: float
    rmse_before: float

    @property
    def space(self) -> Space:
        """The plane or space."""
        return PLANE if len(self.pose) == PLANE.pose else SOLID

    @property
    def angles(self) -> Floats:
        """The heading (1,) or rotation vector (3,), rad."""
        return np.array(self.pose[self.space.dim :])

    @property
    def theta(self) -> float:
        """The heading of a motion in the plane, rad."""
        return self.pose[2]

    def apply(self, points: Floats) -> Floats:
        """The points (n, dim), moved."""
        return self.space.transform(self.pose, points)


def align(a: Floats, b: Floats) -> Alignment:
    """Rotation and translation that minimise Σ‖R aᵢ + t − bᵢ‖², in closed form.

    R = U diag(1, …, det(U Vᵀ)) Vᵀ with U S Vᵀ = Σ bᵢ aᵢᵀ of the centred points, in the plane theta =
    atan2(Σ aᵢ × bᵢ, Σ aᵢ · bᵢ); t = b̄ − R ā (Umeyama, PAMI 13(4) 1991, without scale). ``a`` and ``b``
    are (n, 2) or (n, 3), n at least 1, row by row the same points.
    """
    if a.shape != b.shape or a.ndim != 2 or a.shape[1] not in (2, 3) or a.shape[0] == 0:
        raise ValueError(f"expected two arrays of shape (n, 2) or (n, 3), n at least 1, got {a.shape} and {b.shape}")
    space = PLANE if a.shape[1] == 2 else SOLID
    centre_a, centre_b = a.mean(axis=0), b.mean(axis=0)
    angles = (_heading if space is PLANE else _rotation_vector)(a - centre_a, b - centre_b)
    t = centre_b - space.rotation_of(angles) @ centre_a
    pose = space.as_pose((*t, *angles))
    return Alignment(pose, _rms(space.transform(pose, a) - b), _rms(a - b))


def _heading(u: Floats, v: Floats) -> tuple[float, ...]:
    cross = float(np.sum(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]))
    return (float(np.arctan2(cross, float(np.sum(u * v)))),)


def _rotation_vector(u: Floats, v: Floats) -> tuple[float, ...]:
    U, _, Vt = np.linalg.svd(v.T @ u)
    proper = np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    return so3.rotation_vector(so3.quaternion_of(np.ascontiguousarray(U @ proper @ Vt)))


def _rms(difference: Floats) -> float:
    return float(np.sqrt(np.mean(np.sum(difference**2, axis=1))))
