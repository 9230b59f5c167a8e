"""Sine, cosine and arc tangent that give the same bits on every processor.

A C library picks its trigonometry by the processor it meets (with or without fused
multiply-add), and so may differ in the last bit between two machines. A journal replayed
elsewhere must give equal state, so the kernel carries its own, after FreeBSD's msun
(``k_sin.c``, ``k_cos.c``, ``s_atan.c``), in plain IEEE multiplications and additions.
"""

from __future__ import annotations

import math

import numpy as np

from submaps._jit import jit

PI = math.pi
_TWO_OVER_PI = 2.0 / math.pi
# pi/2 in three parts, the first two of 33 bits: n * part is exact for |n| < 2**20
_PIO2_1 = 1.57079632673412561417e00
_PIO2_2 = 6.07710050630396597660e-11
_PIO2_3 = 2.02226624879595063154e-21
# atan of 0.5, 1, 1.5 and infinity, and what their doubles leave over
_ATAN_HI = (0.463647609000806093515, 0.785398163397448278999, 0.982793723247329054082, 1.57079632679489655800)
_ATAN_LO = (2.269877745296168e-17, 3.061616997868383e-17, 1.390331103123099845e-17, 6.123233995736766e-17)


@jit()
def _sin_kernel(x: float) -> float:
    z = x * x
    r = 8.33333333332248946124e-03 + z * (
        -1.98412698298579493134e-04
        + z * (2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10))
    )
    return x + z * x * (-1.66666666666666324348e-01 + z * r)


@jit()
def _cos_kernel(x: float) -> float:
    z = x * x
    r = z * (
        4.16666666666666019037e-02
        + z
        * (
            -1.38888888888741095749e-03
            + z
            * (
                2.48015872894767294178e-05
                + z * (-2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11))
            )
        )
    )
    half = 0.5 * z
    w = 1.0 - half
    return w + (((1.0 - w) - half) + z * r)


@jit("UniTuple(float64, 2)(float64)")
def sincos(x: float) -> tuple[float, float]:
    """Sine and cosine of ``x`` (rad), good to an ulp for |x| < 1e5."""
    n = math.floor(x * _TWO_OVER_PI + 0.5)
    y = ((x - n * _PIO2_1) - n * _PIO2_2) - n * _PIO2_3
    s = _sin_kernel(y)
    c = _cos_kernel(y)
    quadrant = int(n) & 3
    if quadrant == 0:
        return s, c
    if quadrant == 1:
        return c, -s
    if quadrant == 2:
        return -s, -c
    return -c, s


@jit()
def _atan_positive(x: float) -> float:
    if x < 0.4375:
        part = -1
    elif x < 0.6875:
        part = 0
        x = (2.0 * x - 1.0) / (2.0 + x)
    elif x < 1.1875:
        part = 1
        x = (x - 1.0) / (x + 1.0)
    elif x < 2.4375:
        part = 2
        x = (x - 1.5) / (1.0 + 1.5 * x)
    else:
        part = 3
        x = -1.0 / x
    z = x * x
    w = z * z
    odd = z * (
        3.33333333333329318027e-01
        + w
        * (
            1.42857142725034663711e-01
            + w
            * (
                9.09088713343650656196e-02
                + w * (6.66107313738753120669e-02 + w * (4.97687799461593236017e-02 + w * 1.62858201153657823623e-02))
            )
        )
    )
    even = w * (
        -1.99999999998764832476e-01
        + w
        * (
            -1.11111104054623557880e-01
            + w * (-7.69187620504482999495e-02 + w * (-5.83357013379057348645e-02 + w * -3.65315727442169155270e-02))
        )
    )
    if part < 0:
        return x - x * (odd + even)
    return _ATAN_HI[part] - ((x * (odd + even) - _ATAN_LO[part]) - x)


@jit("float64(float64, float64)")
def arctan2(y: float, x: float) -> float:
    """Angle of the point (x, y) in (-pi, pi]; 0 at the origin."""
    if x == 0.0 and y == 0.0:
        return 0.0
    angle = _atan_positive(abs(y) / abs(x)) if x != 0.0 else 0.5 * PI
    if x < 0.0:
        angle = PI - angle
    return angle if y >= 0.0 else -angle


@jit("float64(float64)")
def wrap(angle: float) -> float:
    """The same angle (rad) in [-pi, pi)."""
    if -PI <= angle < PI:
        return angle
    return angle - 2.0 * PI * math.floor((angle + PI) / (2.0 * PI))


@jit("UniTuple(float64, 2)(float64)")
def rotation_series(phi: float) -> tuple[float, float]:
    """(sin(phi)/phi, (1 - cos(phi))/phi), the entries of V(phi), finite at zero.

    Below 0.1 rad by series, so that neither quotient loses digits.
    """
    if abs(phi) > 0.1:
        s, c = sincos(0.5 * phi)
        return 2.0 * s * c / phi, 2.0 * s * s / phi
    z = phi * phi
    a = 1.0 - z / 6.0 * (1.0 - z / 20.0 * (1.0 - z / 42.0 * (1.0 - z / 72.0)))
    b = 0.5 * phi * (1.0 - z / 12.0 * (1.0 - z / 30.0 * (1.0 - z / 56.0 * (1.0 - z / 90.0))))
    return a, b


EPSILON = float(np.finfo(np.float64).eps)
