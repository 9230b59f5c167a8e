"""Ackermann: a car that turns about a point on its rear axle's line, its speed read at a rear wheel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.geometry.trig import sincos
from submaps.motion import velocity

Floats = NDArray[np.float64]

_arc = velocity.arc


@jit()
def increment(
    control: Floats, covariance: Floats, slip: float, wheelbase: float, encoder_offset: float, dt: float,
    out: Floats, out_covariance: Floats,
) -> None:  # fmt: skip
    """Body-frame increment of the middle of the rear axle, with its covariance (3, 3).

    v = speed / (1 - tan(steer) H / L), omega = v tan(steer) / L, held for ``dt`` (s): ``velocity.arc``
    (Guivant & Nebot, IEEE T-RA 17(3), 2001, with the arc in place of its chord). ``covariance``
    (2, 2) is that of (speed m/s, steer rad); L is the ``wheelbase`` (m), H the ``encoder_offset`` (m)
    to the left, ``slip`` the standard deviation (m/s) of a lateral velocity.
    """
    sine, cosine = sincos(control[1])
    tangent, tangent_by_steer = sine / cosine, 1.0 / (cosine * cosine)
    v_by_speed = 1.0 / (1.0 - tangent * encoder_offset / wheelbase)
    v = control[0] * v_by_speed
    v_by_steer = v * v_by_speed * tangent_by_steer * encoder_offset / wheelbase
    omega_by_speed = v_by_speed * tangent / wheelbase
    omega_by_steer = (v_by_steer * tangent + v * tangent_by_steer) / wheelbase
    ss, sd, dd = covariance[0, 0], covariance[0, 1], covariance[1, 1]
    vv = v_by_speed * v_by_speed * ss + 2.0 * v_by_speed * v_by_steer * sd + v_by_steer * v_by_steer * dd
    crossed = v_by_speed * omega_by_steer + v_by_steer * omega_by_speed
    vw = v_by_speed * omega_by_speed * ss + crossed * sd + v_by_steer * omega_by_steer * dd
    mixed = 2.0 * omega_by_speed * omega_by_steer * sd
    ww = omega_by_speed * omega_by_speed * ss + mixed + omega_by_steer * omega_by_steer * dd
    _arc(v, v * tangent / wheelbase, vv, vw, ww, slip, dt, out, out_covariance)
