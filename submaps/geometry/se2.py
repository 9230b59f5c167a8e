"""The group SE(2): poses (x m, y m, theta rad), tangent order (x, y, theta).

After Sola, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics", 2018,
section "SE(2)". Names: ``a`` is a pose of frame A in the world, ``T_a_b`` takes coordinates in
B to A.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.geometry.trig import rotation_series, sincos, wrap

Floats = NDArray[np.float64]
POSE = "UniTuple(float64, 3)(UniTuple(float64, 3), UniTuple(float64, 3))"
Pose = tuple[float, float, float]
ORIGIN: Pose = (0.0, 0.0, 0.0)


@jit(POSE)
def compose(a: Pose, b: Pose) -> Pose:
    """T_a_c = T_a_b T_b_c: (p_a + R(theta_a) p_b, theta_a + theta_b)."""
    s, c = sincos(a[2])
    return a[0] + c * b[0] - s * b[1], a[1] + s * b[0] + c * b[1], wrap(a[2] + b[2])


@jit("UniTuple(float64, 3)(UniTuple(float64, 3))")
def inverse(a: Pose) -> Pose:
    """T_b_a from T_a_b: (-R(theta)^T p, -theta)."""
    s, c = sincos(a[2])
    return -(c * a[0] + s * a[1]), -(-s * a[0] + c * a[1]), wrap(-a[2])


@jit(POSE)
def between(a: Pose, b: Pose) -> Pose:
    """T_a_b of two poses given in one frame: inverse(a) composed with b."""
    s, c = sincos(a[2])
    dx, dy = b[0] - a[0], b[1] - a[1]
    return c * dx + s * dy, -s * dx + c * dy, wrap(b[2] - a[2])


@jit("UniTuple(float64, 3)(UniTuple(float64, 3))")
def exp(xi: Pose) -> Pose:
    """The pose reached by the tangent (x, y, theta): (V(theta) xi_p, theta) (Sola et al., eq. 156)."""
    a, b = rotation_series(xi[2])
    return a * xi[0] - b * xi[1], b * xi[0] + a * xi[1], wrap(xi[2])


@jit("UniTuple(float64, 3)(UniTuple(float64, 3))")
def log(pose: Pose) -> Pose:
    """The tangent (x, y, theta) of a pose: (V(theta)^-1 p, theta) (Sola et al., eq. 157)."""
    theta = wrap(pose[2])
    a, b = rotation_series(theta)
    det = a * a + b * b
    return (a * pose[0] + b * pose[1]) / det, (a * pose[1] - b * pose[0]) / det, theta


@jit("UniTuple(float64, 2)(UniTuple(float64, 3), float64, float64)")
def transform(a: Pose, x: float, y: float) -> tuple[float, float]:
    """A point given in the frame of pose ``a``, in the frame that ``a`` is given in."""
    s, c = sincos(a[2])
    return a[0] + c * x - s * y, a[1] + s * x + c * y


def adjoint(a: Pose) -> Floats:
    """(3, 3) matrix that carries a tangent across the pose: a exp(xi) = exp(Ad xi) a (Sola, eq. 159)."""
    s, c = sincos(a[2])
    return np.array([[c, -s, a[1]], [s, c, -a[0]], [0.0, 0.0, 1.0]])


def compose_covariance(a: Pose, cov_a: Floats, b: Pose, cov_b: Floats) -> Floats:
    """(3, 3) covariance of a composed with an independent b, additive errors (x, y, theta).

    d(a b)/da = [[I, J R_a p_b], [0, 1]], d(a b)/db = diag(R_a, 1) (Smith, Self, Cheeseman 1990).
    """
    s, c = sincos(a[2])
    by_a = np.array([[1.0, 0.0, -s * b[0] - c * b[1]], [0.0, 1.0, c * b[0] - s * b[1]], [0.0, 0.0, 1.0]])
    by_b = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(by_a @ cov_a @ by_a.T + by_b @ cov_b @ by_b.T)


def inverse_covariance(a: Pose, cov_a: Floats) -> Floats:
    """(3, 3) covariance of the inverse of a pose, additive errors (x, y, theta)."""
    s, c = sincos(a[2])
    x, y, _ = inverse(a)
    by_a = np.array([[-c, -s, y], [s, -c, -x], [0.0, 0.0, -1.0]])
    return np.asarray(by_a @ cov_a @ by_a.T)
