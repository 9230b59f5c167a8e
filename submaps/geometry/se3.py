"""The group SE(3) as pairs: poses (x m, y m, z m, then the rotation vector, rad), errors in the same order.

A pose's error is additive in position and, in rotation, about the axes of the outer frame: p = p^ + e_p,
R = exp(e_theta) R^. Names as in ``geometry.se2``: ``a`` is a pose of frame A, ``T_a_b`` takes coordinates
in B to A.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.geometry import so3

Floats = NDArray[np.float64]
Pose = tuple[float, float, float, float, float, float]
ORIGIN: Pose = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_POSE = "UniTuple(float64, 6)(UniTuple(float64, 6), UniTuple(float64, 6))"

_quaternion, _rotation_vector, _multiply = so3.quaternion, so3.rotation_vector, so3.multiply


@jit()
def _rotate(q: so3.Quaternion, x: float, y: float, z: float) -> so3.Vector:
    """R(q) (x, y, z) = v + 2 w (u x v) + 2 u x (u x v), u the quaternion's vector part."""
    t0 = 2.0 * (q[1] * z - q[2] * y)
    t1 = 2.0 * (q[2] * x - q[0] * z)
    t2 = 2.0 * (q[0] * y - q[1] * x)
    return (
        x + q[3] * t0 + q[1] * t2 - q[2] * t1,
        y + q[3] * t1 + q[2] * t0 - q[0] * t2,
        z + q[3] * t2 + q[0] * t1 - q[1] * t0,
    )


@jit(_POSE)
def compose(a: Pose, b: Pose) -> Pose:
    """T_a_c = T_a_b T_b_c: (p_a + R_a p_b, R_a R_b)."""
    q = _quaternion(a[3], a[4], a[5])
    x, y, z = _rotate(q, b[0], b[1], b[2])
    r = _rotation_vector(_multiply(q, _quaternion(b[3], b[4], b[5])))
    return a[0] + x, a[1] + y, a[2] + z, r[0], r[1], r[2]


@jit("UniTuple(float64, 6)(UniTuple(float64, 6))")
def inverse(a: Pose) -> Pose:
    """T_b_a from T_a_b: (-R^T p, R^T)."""
    x, y, z = _rotate(_quaternion(-a[3], -a[4], -a[5]), a[0], a[1], a[2])
    return -x, -y, -z, -a[3], -a[4], -a[5]


@jit(_POSE)
def between(a: Pose, b: Pose) -> Pose:
    """T_a_b of two poses given in one frame: inverse(a) composed with b."""
    q = _quaternion(-a[3], -a[4], -a[5])
    x, y, z = _rotate(q, b[0] - a[0], b[1] - a[1], b[2] - a[2])
    r = _rotation_vector(_multiply(q, _quaternion(b[3], b[4], b[5])))
    return x, y, z, r[0], r[1], r[2]


@jit("UniTuple(float64, 3)(UniTuple(float64, 6), float64, float64, float64)")
def transform(a: Pose, x: float, y: float, z: float) -> so3.Vector:
    """A point given in the frame of pose ``a``, in the frame that ``a`` is given in."""
    u, v, w = _rotate(_quaternion(a[3], a[4], a[5]), x, y, z)
    return a[0] + u, a[1] + v, a[2] + w


def exp(xi: Pose) -> Pose:
    """The pose reached by the tangent (position, rotation): (V(xi_theta) xi_p, xi_theta) (Sola et al., eq. 172)."""
    V = np.empty((3, 3))
    so3.left_jacobian(xi[3], xi[4], xi[5], V)
    x, y, z = np.sum(V * np.array(xi[:3]), axis=1).tolist()
    r = _rotation_vector(_quaternion(xi[3], xi[4], xi[5]))
    return x, y, z, r[0], r[1], r[2]


def log(pose: Pose) -> Pose:
    """The tangent (position, rotation) of a pose: (V(r)^-1 p, r) (Sola et al., eq. 173)."""
    W = np.empty((3, 3))
    r = _rotation_vector(_quaternion(pose[3], pose[4], pose[5]))
    so3.left_jacobian_inverse(r[0], r[1], r[2], W)
    x, y, z = np.sum(W * np.array(pose[:3]), axis=1).tolist()
    return x, y, z, r[0], r[1], r[2]
