"""The filter's equations on one sub-map's arrays: update and augment; compiled, for the plane and space alike.

The state is x = (position, rotation, l_1, l_2, ...): (p_x, p_y, theta, l_1x, l_1y, ...) in the plane, with a
rotation vector in space. Its covariance is the leading (n, n) block of P, kept whole and equal to its transpose
bit for bit. With the right-invariant error (Barrau & Bonnabel, arXiv:1510.06263; Zhang et al.,
arXiv:1702.06680) P is that of xi = (xi_p, xi_theta, xi_1, ...), with R = exp(xi_theta) R^, p = exp(xi_theta) p^
+ V(xi_theta) xi_p and alike for each l_i; with the standard error it is that of the additive errors, R =
exp(e_theta) R^. turn(p) is J p in the plane and -S(p) in space (``geometry.space``).

Readings of fewer numbers than there are dimensions are filled up with rows that say nothing, those of more
are reduced to what they say of the point: so every update has ``dim`` rows.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.filtering.passes import add_and_subtract, gain_columns, gain_of_prediction, subtract, whiten
from submaps.filtering.reducing import reduce
from submaps.filtering.workspace import (
    CARRIED,
    GAIN,
    INNOVATION,
    INNOVATION_COVARIANCE,
    JACOBIAN,
    NOISE,
    OFFSET,
    POINT,
    READING_NOISE,
    ROTATION,
    SLOPE,
    SPREAD,
    STEP,
    TURNING,
)
from submaps.geometry import so3
from submaps.geometry.space import Key
from submaps.geometry.trig import EPSILON, rotation_series, sincos, wrap
from submaps.observation.models import channels, innovate, invert, predict

Floats = NDArray[np.float64]

USED, GATED, FLAGGED, SINGULAR, LATE, LOST, FIRST = 0, 1, 2, 3, 4, 5, 6

_quaternion, _multiply, _rotation_vector = so3.quaternion, so3.multiply, so3.rotation_vector
_entries, _left_jacobian_entries = so3.entries, so3.left_jacobian_entries


@jit(inline=True)
def _put_rotation(space: Key, x: Floats, at: int, w: Floats) -> None:
    """The rotation matrix of the heading or rotation vector at ``x[at]``, to ``ROTATION``."""
    if len(space) == 2:
        s, c = sincos(x[at])
        w[ROTATION], w[ROTATION + 1], w[ROTATION + 2], w[ROTATION + 3] = c, -s, s, c
    else:
        R = _entries(x[at], x[at + 1], x[at + 2])
        for i in range(9):
            w[ROTATION + i] = R[i]


@jit(inline=True)
def _cholesky(space: Key, w: Floats) -> bool:
    """Cholesky factor of ``INNOVATION_COVARIANCE`` in place; false at a pivot that is bad or lost to rounding."""
    dim, S = len(space), INNOVATION_COVARIANCE
    for i in range(dim):
        for j in range(i + 1):
            total = w[S + dim * i + j]
            for k in range(j):
                total -= w[S + dim * i + k] * w[S + dim * j + k]
            if i != j:
                w[S + dim * i + j] = total / w[S + dim * j + j]
            elif total > (4.0 * EPSILON * w[S + dim * i + i] if i else 0.0) and total < math.inf:
                w[S + dim * i + i] = math.sqrt(total)
            else:
                return False
    return True


@jit(inline=True)
def retract(space: Key, x: Floats, n: int, A: Floats, invariant: bool, w: Floats) -> None:
    """Apply xi = A^T v, v at ``INNOVATION``: x <- exp(xi_theta) x + V(xi_theta) xi for every point, or x + xi."""
    dim, pose = len(space), 3 * len(space) - 3
    for i in range(dim, pose):
        total = 0.0
        for a in range(dim):
            total += A[a, i] * w[INNOVATION + a]
        w[STEP + i] = total
    if not invariant:
        _add(space, x, n, A, w)
    elif len(space) == 2:
        _retract_plane(x, n, A[0], A[1], w[INNOVATION], w[INNOVATION + 1], w[STEP + 2])
    else:
        _put_rotation(space, w, STEP + dim, w)
        V = _left_jacobian_entries(w[STEP + 3], w[STEP + 4], w[STEP + 5])
        for i in range(9):
            w[JACOBIAN + i] = V[i]
        _retract_space(x, n, A[0], A[1], A[2], w)
    if len(space) == 2:
        x[2] = wrap(x[2] + w[STEP + 2])
    else:
        q = _multiply(_quaternion(w[STEP + 3], w[STEP + 4], w[STEP + 5]), _quaternion(x[3], x[4], x[5]))
        x[3], x[4], x[5] = _rotation_vector(q)


@jit()
def _add(space: Key, x: Floats, n: int, A: Floats, w: Floats) -> None:
    dim, pose = len(space), 3 * len(space) - 3
    j = 0
    while j < n:
        for i in range(dim):
            total = 0.0
            for a in range(dim):
                total += A[a, j + i] * w[INNOVATION + a]
            x[j + i] += total
        j += pose if j == 0 else dim


@jit(inline=True)
def _retract_plane(x: Floats, n: int, a: Floats, b: Floats, wa: float, wb: float, heading: float) -> None:
    s, c = sincos(heading)
    v, w = rotation_series(heading)
    j = 0
    while j < n:
        d0 = a[j] * wa + b[j] * wb
        d1 = a[j + 1] * wa + b[j + 1] * wb
        x0, x1 = x[j], x[j + 1]
        x[j] = c * x0 - s * x1 + v * d0 - w * d1
        x[j + 1] = s * x0 + c * x1 + w * d0 + v * d1
        j += 3 if j == 0 else 2


@jit()
def _retract_space(x: Floats, n: int, a: Floats, b: Floats, c: Floats, w: Floats) -> None:
    w0, w1, w2 = w[INNOVATION], w[INNOVATION + 1], w[INNOVATION + 2]
    j = 0
    while j < n:
        d0 = a[j] * w0 + b[j] * w1 + c[j] * w2
        d1 = a[j + 1] * w0 + b[j + 1] * w1 + c[j + 1] * w2
        d2 = a[j + 2] * w0 + b[j + 2] * w1 + c[j + 2] * w2
        x0, x1, x2 = x[j], x[j + 1], x[j + 2]
        for i in range(3):
            r, v = ROTATION + 3 * i, JACOBIAN + 3 * i
            turned = w[r] * x0 + w[r + 1] * x1 + w[r + 2] * x2
            x[j + i] = turned + w[v] * d0 + w[v + 1] * d1 + w[v + 2] * d2
        j += 6 if j == 0 else 3


@jit(inline=True)
def linearise(
    space: Key, x: Floats, k: int, model: int, sensor: Floats, at: int, z: Floats, zat: int, R: Floats, w: Floats
) -> float:
    """One reading of the landmark at x[k:k+dim] as dim rows, in ``w``: its slope, innovation and noise.

    y = R^T (l - p); ``GAIN`` = dh/dy R^T on l - p, ``TURNING`` = -dh/dy R^T turn(l - p) on the rotation of the
    standard error. The sensor begins at ``sensor[at]``, the reading at ``z[zat]``. Returns what ``reduce`` does.
    """
    dim = len(space)
    _put_rotation(space, x, dim, w)
    for i in range(dim):
        w[OFFSET + i] = x[k + i] - x[i]
    for i in range(dim):
        total = 0.0
        for j in range(dim):
            total += w[ROTATION + dim * j + i] * w[OFFSET + j]
        w[POINT + i] = total
    predict(space, model, sensor, at, w)
    innovate(space, model, z, zat, w)
    rest = reduce(space, channels(space, model), R, w)
    for a in range(dim):
        for j in range(dim):
            total = 0.0
            for i in range(dim):
                total += w[SLOPE + dim * a + i] * w[ROTATION + dim * j + i]
            w[GAIN + dim * a + j] = total
    for a in range(dim):
        g, t = GAIN + dim * a, TURNING + (2 * dim - 3) * a
        if len(space) == 2:
            w[t] = w[g] * w[OFFSET + 1] - w[g + 1] * w[OFFSET]
        else:
            w[t] = w[g + 1] * w[OFFSET + 2] - w[g + 2] * w[OFFSET + 1]
            w[t + 1] = w[g + 2] * w[OFFSET] - w[g] * w[OFFSET + 2]
            w[t + 2] = w[g] * w[OFFSET + 1] - w[g + 1] * w[OFFSET]
    return rest


@jit(inline=True)
def _innovation_covariance(space: Key, k: int, A: Floats, invariant: bool, w: Floats) -> None:
    """S = H P H^T + R, of A = H P, to ``INNOVATION_COVARIANCE``."""
    dim, rot = len(space), 2 * len(space) - 3
    for a in range(dim):
        for b in range(a + 1):
            total = 0.0
            for i in range(dim):
                total += w[GAIN + dim * a + i] * (A[b, k + i] - A[b, i])
            if not invariant:
                for i in range(rot):
                    total += w[TURNING + rot * a + i] * A[b, dim + i]
            w[INNOVATION_COVARIANCE + dim * a + b] = total + w[NOISE + dim * a + b]


@jit()
def update(
    space: Key, x: Floats, P: Floats, n: int, k: int, model: int, sensor: Floats, at: int, z: Floats, zat: int,
    R: Floats, gate: float, flag: float, invariant: bool, U: Floats, has_u: bool, A: Floats, hold: bool, xi: Floats,
    w: Floats,
) -> tuple[int, float]:  # fmt: skip
    """One observation of the landmark at x[k:k+dim]; returns (status, normalised innovation squared).

    H = dh/dy [-R^T, 0, ..., R^T, ...] on the invariant error, with -dh/dy R^T turn(l - p) in the rotation's
    columns on the standard one; S = H P H^T + R = L L^T; P <- P - A^T A with A = L^-1 H P.
    Rejected observations (GATED, SINGULAR) leave x and P as they were, with U still to be added. With ``hold``
    x stays where it is and xi (n,) takes the correction, so that several readings are linearised at one state,
    as in a joint update; ``retract_held`` then applies it.
    """
    dim, S, v = len(space), INNOVATION_COVARIANCE, INNOVATION
    rest = linearise(space, x, k, model, sensor, at, z, zat, R, w)
    if hold:
        _less_held(space, k, xi, invariant, w)
    gain_columns(space, P, n, k, not invariant, A, w)
    if has_u:
        gain_of_prediction(space, n, k, U, A, w)
    _innovation_covariance(space, k, A, invariant, w)
    if not _cholesky(space, w):
        return SINGULAR, math.nan
    nis = 0.0
    for a in range(dim):
        total = w[v + a]
        for b in range(a):
            total -= w[S + dim * a + b] * w[v + b]
        w[v + a] = total / w[S + dim * a + a]
        nis += w[v + a] * w[v + a]
    nis += rest
    if not nis < math.inf:
        return SINGULAR, math.nan
    if nis > gate:
        return GATED, nis
    whiten(space, n, A, w)
    if hold:
        for a in range(dim):
            for j in range(n):
                xi[j] += A[a, j] * w[v + a]
    else:
        retract(space, x, n, A, invariant, w)
    if has_u:
        add_and_subtract(space, P, n, U, A)
    else:
        subtract(space, P, n, A)
    return (FLAGGED if nis > flag else USED), nis


@jit()
def _less_held(space: Key, k: int, xi: Floats, invariant: bool, w: Floats) -> None:
    """The innovation less H xi, of a correction that is held back."""
    dim, rot = len(space), 2 * len(space) - 3
    for a in range(dim):
        for i in range(dim):
            w[INNOVATION + a] -= w[GAIN + dim * a + i] * (xi[k + i] - xi[i])
        if not invariant:
            for i in range(rot):
                w[INNOVATION + a] -= w[TURNING + rot * a + i] * xi[dim + i]


@jit()
def retract_held(space: Key, x: Floats, n: int, xi: Floats, A: Floats, invariant: bool, w: Floats) -> None:
    """Apply the correction that updates with ``hold`` have gathered in xi (n,)."""
    for a in range(len(space)):
        for j in range(n):
            A[a, j] = xi[j] if a == 0 else 0.0
        w[INNOVATION + a] = 1.0 if a == 0 else 0.0
    retract(space, x, n, A, invariant, w)


@jit()
def augment(
    space: Key, x: Floats, P: Floats, n: int, model: int, sensor: Floats, at: int, z: Floats, zat: int, R: Floats,
    invariant: bool, w: Floats,
) -> bool:  # fmt: skip
    """Append the landmark that a reading shows at x[n:n+dim]; false if it is not finite.

    l = p + R y(z). xi_new = xi_p + R e on the invariant error, dp + turn(R y) dtheta + R e on the standard
    one, e the reading's noise (and the prior of what it leaves open) carried into the body frame.
    """
    dim = len(space)
    _put_rotation(space, x, dim, w)
    count = invert(space, model, sensor, at, z, zat, R, w)
    size = 0.0
    for i in range(dim):
        total = 0.0
        for j in range(dim):
            total += w[ROTATION + dim * i + j] * w[POINT + j]
        w[OFFSET + i] = total
        size += abs(total)
        for b in range(count):
            total = 0.0
            for k in range(dim):
                total += w[ROTATION + dim * i + k] * w[SPREAD + 4 * k + b]
            w[CARRIED + 4 * i + b] = total
    for i in range(dim):
        for j in range(i + 1):
            variance = 0.0
            for b in range(count):
                along = 0.0
                for a in range(count):
                    along += w[CARRIED + 4 * j + a] * w[READING_NOISE + 4 * a + b]
                variance += w[CARRIED + 4 * i + b] * along
            w[NOISE + dim * i + j] = variance
        size += w[NOISE + dim * i + i]
    if not size < math.inf:
        return False
    _append(space, x, P, n, invariant, w)
    return True


@jit()
def _append(space: Key, x: Floats, P: Floats, n: int, invariant: bool, w: Floats) -> None:
    """A landmark at p + d, d at ``OFFSET``, with ``NOISE`` (its lower triangle) in the outer frame."""
    dim = len(space)
    d0, d1, d2 = w[OFFSET], w[OFFSET + 1], w[OFFSET + 2]
    for i in range(dim):
        for j in range(n):
            P[n + i, j] = P[i, j]
    if not invariant:
        if len(space) == 2:
            for j in range(n):
                P[n, j] -= d1 * P[2, j]
                P[n + 1, j] += d0 * P[2, j]
        else:
            for j in range(n):
                P[n, j] += d2 * P[4, j] - d1 * P[5, j]
                P[n + 1, j] += d0 * P[5, j] - d2 * P[3, j]
                P[n + 2, j] += d1 * P[3, j] - d0 * P[4, j]
    for i in range(dim):
        for j in range(i + 1):
            total = P[n + i, j]
            if not invariant:
                if len(space) == 2:
                    total += (-d1 if j == 0 else d0) * P[n + i, 2]
                else:
                    one, two = (j + 1) % 3, (j + 2) % 3
                    total += w[OFFSET + two] * P[n + i, 3 + one] - w[OFFSET + one] * P[n + i, 3 + two]
            P[n + i, n + j] = total + w[NOISE + dim * i + j]
            P[n + j, n + i] = P[n + i, n + j]
        for j in range(n):
            P[j, n + i] = P[n + i, j]
        x[n + i] = x[i] + w[OFFSET + i]
