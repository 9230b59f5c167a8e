"""The group SO(3): rotation vectors (rad) and unit quaternions (x, y, z, w).

A rotation is kept as its rotation vector phi, R = exp(S(phi)), S the cross-product matrix: three
numbers, like the error of a rotation, so that a state and its covariance share their indices. It is
turned into a quaternion where rotations compose. After Sola, Deray, Atchuthan, "A micro Lie theory for
state estimation in robotics", 2018, appendix B.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.geometry.trig import arctan2, rotation_series, sincos

Floats = NDArray[np.float64]
Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Nine = tuple[float, float, float, float, float, float, float, float, float]
_TINY = 1e-9


@jit()
def _fill(entries: Nine, out: Floats) -> None:
    for i in range(3):
        for j in range(3):
            out[i, j] = entries[3 * i + j]


@jit("UniTuple(float64, 4)(float64, float64, float64)")
def quaternion(x: float, y: float, z: float) -> Quaternion:
    """The unit quaternion (x, y, z, w) of a rotation vector (rad)."""
    half = 0.5 * math.sqrt(x * x + y * y + z * z)
    k = 0.5 * rotation_series(half)[0]
    return k * x, k * y, k * z, sincos(half)[1]


@jit("UniTuple(float64, 3)(UniTuple(float64, 4))")
def rotation_vector(q: Quaternion) -> Vector:
    """The rotation vector (rad), no longer than pi, of a quaternion (x, y, z, w) of any length above 0."""
    x, y, z, w = q
    if w < 0.0:
        x, y, z, w = -x, -y, -z, -w
    sine = math.sqrt(x * x + y * y + z * z)
    k = 2.0 * arctan2(sine, w) / sine if sine > _TINY * w else 2.0 / w
    return k * x, k * y, k * z


@jit("UniTuple(float64, 4)(UniTuple(float64, 4), UniTuple(float64, 4))")
def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """The quaternion of R(a) R(b)."""
    return (
        a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
        a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
        a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
        a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
    )


@jit("UniTuple(float64, 9)(float64, float64, float64)")
def entries(x: float, y: float, z: float) -> Nine:
    """The rotation matrix of a rotation vector (rad), row by row."""
    i, j, k, w = quaternion(x, y, z)
    return (
        1.0 - 2.0 * (j * j + k * k), 2.0 * (i * j - k * w), 2.0 * (i * k + j * w),
        2.0 * (i * j + k * w), 1.0 - 2.0 * (i * i + k * k), 2.0 * (j * k - i * w),
        2.0 * (i * k - j * w), 2.0 * (j * k + i * w), 1.0 - 2.0 * (i * i + j * j),
    )  # fmt: skip


@jit("void(float64, float64, float64, float64[:, :])")
def matrix(x: float, y: float, z: float, out: Floats) -> None:
    """The rotation matrix (3, 3) of a rotation vector (rad), into ``out``."""
    _fill(entries(x, y, z), out)


@jit("UniTuple(float64, 4)(float64[:, :])")
def quaternion_of(R: Floats) -> Quaternion:
    """The unit quaternion (x, y, z, w), w not below 0, of a rotation matrix (3, 3)."""
    # The largest of the four squares is divided by (Shepperd 1978).
    w = 1.0 + R[0, 0] + R[1, 1] + R[2, 2]
    x = 1.0 + R[0, 0] - R[1, 1] - R[2, 2]
    y = 1.0 - R[0, 0] + R[1, 1] - R[2, 2]
    z = 1.0 - R[0, 0] - R[1, 1] + R[2, 2]
    if w >= x and w >= y and w >= z:
        q = (R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], w)
    elif x >= y and x >= z:
        q = (x, R[0, 1] + R[1, 0], R[0, 2] + R[2, 0], R[2, 1] - R[1, 2])
    elif y >= z:
        q = (R[0, 1] + R[1, 0], y, R[1, 2] + R[2, 1], R[0, 2] - R[2, 0])
    else:
        q = (R[0, 2] + R[2, 0], R[1, 2] + R[2, 1], z, R[1, 0] - R[0, 1])
    scale = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    if q[3] < 0.0:
        scale = -scale
    return q[0] / scale, q[1] / scale, q[2] / scale, q[3] / scale


@jit("UniTuple(float64, 2)(float64)")
def series(squared: float) -> tuple[float, float]:
    """((1 - cos a) / a^2, (a - sin a) / a^3) of the angle a (rad) whose square is given, finite at zero."""
    if squared > 0.09:
        a = math.sqrt(squared)
        s, c = sincos(0.5 * a)
        return 2.0 * s * s / squared, (a - 2.0 * s * c) / (a * squared)
    z = squared
    b = 0.5 * (1.0 - z / 12.0 * (1.0 - z / 30.0 * (1.0 - z / 56.0 * (1.0 - z / 90.0 * (1.0 - z / 132.0)))))
    d = (1.0 - z / 20.0 * (1.0 - z / 42.0 * (1.0 - z / 72.0 * (1.0 - z / 110.0 * (1.0 - z / 156.0))))) / 6.0
    return b, d


@jit("UniTuple(float64, 2)(float64)")
def inverse_series(squared: float) -> tuple[float, float]:
    """g = (1 - (a/2) cot(a/2)) / a^2 of the angle a (rad) whose square is given, and (dg/da) / a."""
    if squared > 0.09:
        a = math.sqrt(squared)
        s, c = sincos(0.5 * a)
        cot = c / s
        g = (1.0 - 0.5 * a * cot) / squared
        return g, (-2.0 / squared + 0.5 * cot / a + 0.25 / (s * s)) / squared
    z = squared
    b = (1.0 / 12.0, 1.0 / 720.0, 1.0 / 30240.0, 1.0 / 1209600.0, 1.0 / 47900160.0, 691.0 / 1307674368000.0)
    g = b[0] + z * (b[1] + z * (b[2] + z * (b[3] + z * (b[4] + z * b[5]))))
    return g, 2.0 * (b[1] + z * (2.0 * b[2] + z * (3.0 * b[3] + z * (4.0 * b[4] + z * 5.0 * b[5]))))


@jit("UniTuple(float64, 9)(float64, float64, float64, float64, float64, float64)")
def _polynomial(x: float, y: float, z: float, one: float, first: float, second: float) -> Nine:
    """one I + first S + second S^2 of the cross-product matrix S of (x, y, z), row by row."""
    diagonal = one - second * (x * x + y * y + z * z)
    return (
        diagonal + second * x * x, second * x * y - first * z, second * x * z + first * y,
        second * x * y + first * z, diagonal + second * y * y, second * y * z - first * x,
        second * x * z - first * y, second * y * z + first * x, diagonal + second * z * z,
    )  # fmt: skip


@jit("UniTuple(float64, 9)(float64, float64, float64)")
def left_jacobian_entries(x: float, y: float, z: float) -> Nine:
    """V(phi) = I + (1 - cos a)/a^2 S + (a - sin a)/a^3 S^2, a = |phi| (Sola et al., eq. 145), row by row.

    exp(phi + e) = exp(V(phi) e) exp(phi) to first order in e.
    """
    b, d = series(x * x + y * y + z * z)
    return _polynomial(x, y, z, 1.0, b, d)


@jit("void(float64, float64, float64, float64[:, :])")
def left_jacobian(x: float, y: float, z: float, out: Floats) -> None:
    """V(phi) (3, 3), into ``out``."""
    _fill(left_jacobian_entries(x, y, z), out)


@jit("void(float64, float64, float64, float64[:, :])")
def left_jacobian_inverse(x: float, y: float, z: float, out: Floats) -> None:
    """V(phi)^-1 = I - S/2 + (1 - (a/2) cot(a/2))/a^2 S^2 (Sola et al., eq. 146), into ``out`` (3, 3)."""
    g, _ = inverse_series(x * x + y * y + z * z)
    _fill(_polynomial(x, y, z, 1.0, -0.5, g), out)
