"""Velocity: constant v and omega over the interval, an exact arc with its straight-line limit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.geometry.trig import rotation_series, sincos

Floats = NDArray[np.float64]


@jit()
def rotation_series_slopes(phi: float) -> tuple[float, float]:
    """Derivatives of sin(phi)/phi and (1 - cos(phi))/phi, by series near zero."""
    if abs(phi) > 0.3:
        s, c = sincos(phi)
        return (c - s / phi) / phi, (s - (1.0 - c) / phi) / phi
    z = phi * phi
    a = -phi / 3.0 * (1.0 - z / 10.0 * (1.0 - z / 28.0 * (1.0 - z / 54.0 * (1.0 - z / 88.0))))
    b = 0.5 * (1.0 - z / 4.0 * (1.0 - z / 18.0 * (1.0 - z / 40.0 * (1.0 - z / 70.0 * (1.0 - z / 108.0)))))
    return a, b


@jit()
def arc(
    v: float, omega: float, vv: float, vw: float, ww: float, slip: float, dt: float, out: Floats, out_covariance: Floats
) -> None:
    """Body-frame increment of an arc: V(omega dt) (v dt, 0), omega dt, with its covariance (3, 3).

    x = v/omega sin(omega dt), y = v/omega (1 - cos(omega dt)): the arc of the EKF-SLAM lecture, at
    theta = 0. ``vv``, ``vw`` and ``ww`` are the covariance of (v m/s, omega rad/s); ``slip`` the
    standard deviation (m/s) of a lateral velocity that enters beside v.
    """
    phi = omega * dt
    a, b = rotation_series(phi)
    da, db = rotation_series_slopes(phi)
    out[0], out[1], out[2] = v * dt * a, v * dt * b, phi
    by_omega = (v * dt * dt * da, v * dt * dt * db, dt)
    by_v = (dt * a, dt * b, 0.0)
    by_slip = (-dt * b * slip, dt * a * slip, 0.0)
    for i in range(3):
        for j in range(3):
            mixed = by_v[i] * by_omega[j] + by_omega[i] * by_v[j]
            own = by_v[i] * by_v[j] * vv + by_omega[i] * by_omega[j] * ww + by_slip[i] * by_slip[j]
            out_covariance[i, j] = own + mixed * vw


@jit()
def increment(control: Floats, covariance: Floats, slip: float, dt: float, out: Floats, out_covariance: Floats) -> None:
    """Increment of one reading (v m/s, omega rad/s), ``covariance`` (2, 2) its own: ``arc``."""
    vv, vw, ww = covariance[0, 0], covariance[0, 1], covariance[1, 1]
    arc(control[0], control[1], vv, vw, ww, slip, dt, out, out_covariance)
