"""Bicycle: speed and steer of the front wheel, whose contact point is where the robot is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.geometry.trig import sincos

Floats = NDArray[np.float64]


@jit()
def increment(
    control: Floats, covariance: Floats, wheelbase: float, dt: float, out: Floats, out_covariance: Floats
) -> None:
    """Body-frame increment s dt (cos d, sin d, sin d / B), with its covariance (3, 3).

    x += s dt cos(psi + d), y += s dt sin(psi + d), psi += s dt sin(d) / B: the process model of the
    SLAM lecture, for the front wheel's contact point. ``covariance`` (2, 2) is that of the speed s
    (m/s) and the steer d (rad); B is the ``wheelbase`` (m).
    """
    distance = control[0] * dt
    sine, cosine = sincos(control[1])
    out[0], out[1], out[2] = distance * cosine, distance * sine, distance * sine / wheelbase
    by_speed = (dt * cosine, dt * sine, dt * sine / wheelbase)
    by_steer = (-distance * sine, distance * cosine, distance * cosine / wheelbase)
    ss, sd, dd = covariance[0, 0], covariance[0, 1], covariance[1, 1]
    for i in range(3):
        for j in range(3):
            mixed = by_speed[i] * by_steer[j] + by_steer[i] * by_speed[j]
            own = by_speed[i] * by_speed[j] * ss + by_steer[i] * by_steer[j] * dd
            out_covariance[i, j] = own + mixed * sd
