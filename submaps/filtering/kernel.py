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
from submaps.filtering.workspace import Workspace
from submaps.geometry import so3
from submaps.geometry.space import Key, fill_left_jacobian, fill_rotation
from submaps.geometry.trig import EPSILON, rotation_series, sincos, wrap
from submaps.observation.models import channels, innovate, invert, predict, turn_columns

Floats = NDArray[np.float64]

USED, GATED, FLAGGED, SINGULAR, LATE, LOST, FIRST = 0, 1, 2, 3, 4, 5, 6

_quaternion, _multiply, _rotation_vector = so3.quaternion, so3.multiply, so3.rotation_vector


@jit()
def cholesky(space: Key, S: Floats) -> bool:
    """Lower Cholesky factor of S (dim, dim) in place; false at a pivot that is bad or lost to rounding."""
    for i in range(len(space)):
        for j in range(i + 1):
            total = S[i, j]
            for k in range(j):
                total -= S[i, k] * S[j, k]
            if i != j:
                S[i, j] = total / S[j, j]
            elif total > (4.0 * EPSILON * S[i, i] if i else 0.0) and total < math.inf:
                S[i, i] = math.sqrt(total)
            else:
                return False
    return True


@jit()
def _add_turning(space: Key, x: Floats, e: Floats) -> None:
    """The rotation of x turned by e (rot,) about the outer axes: R <- exp(e) R."""
    if len(space) == 2:
        x[2] = wrap(x[2] + e[0])
    else:
        q = _multiply(_quaternion(e[0], e[1], e[2]), _quaternion(x[3], x[4], x[5]))
        x[3], x[4], x[5] = _rotation_vector(q)


@jit()
def retract(space: Key, x: Floats, n: int, A: Floats, weights: Floats, invariant: bool, w: Workspace) -> None:
    """Apply xi = A^T weights: x <- exp(xi_theta) x + V(xi_theta) xi for every point, or x + xi."""
    dim, pose = len(space), 3 * len(space) - 3
    for i in range(dim, pose):
        total = 0.0
        for a in range(dim):
            total += A[a, i] * weights[a]
        w.step[i] = total
    if not invariant:
        j = 0
        while j < n:
            for i in range(dim):
                total = 0.0
                for a in range(dim):
                    total += A[a, j + i] * weights[a]
                x[j + i] += total
            j += pose if j == 0 else dim
    elif len(space) == 2:
        _retract_plane(x, n, A[0], A[1], weights[0], weights[1], w.step[2])
    else:
        fill_rotation(space, w.step[dim:], w.rotation)
        fill_left_jacobian(space, w.step[dim:], w.jacobian)
        _retract_space(x, n, A, weights, w.rotation, w.jacobian)
    _add_turning(space, x, w.step[dim:])


@jit()
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
def _retract_space(x: Floats, n: int, A: Floats, weights: Floats, R: Floats, V: Floats) -> None:
    w0, w1, w2 = weights[0], weights[1], weights[2]
    a, b, c = A[0], A[1], A[2]
    j = 0
    while j < n:
        d0 = a[j] * w0 + b[j] * w1 + c[j] * w2
        d1 = a[j + 1] * w0 + b[j + 1] * w1 + c[j + 1] * w2
        d2 = a[j + 2] * w0 + b[j + 2] * w1 + c[j + 2] * w2
        x0, x1, x2 = x[j], x[j + 1], x[j + 2]
        for i in range(3):
            turned = R[i, 0] * x0 + R[i, 1] * x1 + R[i, 2] * x2
            x[j + i] = turned + V[i, 0] * d0 + V[i, 1] * d1 + V[i, 2] * d2
        j += 6 if j == 0 else 3


@jit()
def reduce(space: Key, count: int, R: Floats, w: Workspace) -> float:
    """Bring ``w.slope`` and ``w.innovation`` of ``count`` channels to dim rows of noise ``w.noise``.

    A reading of more numbers is whitened, L^-1 dh/dy = Q T, and replaced by Q^T L^-1 v = T dy + unit noise;
    returned is the squared norm of the rest of L^-1 v, which says nothing of the point.
    """
    dim = len(space)
    if count > dim:
        return _reduce_many(dim, count, R, w)
    for a in range(dim):
        for b in range(dim):
            w.noise[a, b] = R[a, b] if a < count and b < count else (1.0 if a == b else 0.0)
        if a >= count:
            w.innovation[a] = 0.0
            w.slope[a, :] = 0.0
    return 0.0


@jit()
def _reduce_many(dim: int, count: int, R: Floats, w: Workspace) -> float:
    L, H, v = w.whitened, w.slope, w.innovation
    for i in range(count):
        for j in range(i + 1):
            total = R[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            L[i, j] = math.sqrt(total) if i == j else total / L[j, j]
        for k in range(i):
            v[i] -= L[i, k] * v[k]
            for j in range(dim):
                H[i, j] -= L[i, k] * H[k, j]
        v[i] /= L[i, i]
        for j in range(dim):
            H[i, j] /= L[i, i]
    # Modified Gram-Schmidt: the columns of H become Q, ``w.noise`` holds T until the end.
    for j in range(dim):
        norm = 0.0
        for i in range(count):
            norm += H[i, j] * H[i, j]
        norm = math.sqrt(norm)
        for k in range(dim):
            w.noise[j, k] = 0.0
        w.noise[j, j] = norm
        for i in range(count):
            H[i, j] /= norm
        for k in range(j + 1, dim):
            dot = 0.0
            for i in range(count):
                dot += H[i, j] * H[i, k]
            w.noise[j, k] = dot
            for i in range(count):
                H[i, k] -= dot * H[i, j]
    for j in range(dim):
        dot = 0.0
        for i in range(count):
            dot += H[i, j] * v[i]
        w.step[j] = dot
        for i in range(count):
            v[i] -= dot * H[i, j]
    rest = 0.0
    for i in range(count):
        rest += v[i] * v[i]
    for j in range(dim):
        v[j] = w.step[j]
        for k in range(dim):
            H[j, k] = w.noise[j, k]
            w.noise[j, k] = 1.0 if j == k else 0.0
    return rest


@jit()
def linearise(space: Key, x: Floats, k: int, model: int, sensor: Floats, z: Floats, R: Floats, w: Workspace) -> float:
    """One reading of the landmark at x[k:k+dim] as dim rows: ``w.gain``, ``w.turning``, ``w.innovation``, ``w.noise``.

    y = R^T (l - p); ``w.gain`` = dh/dy R^T on l - p, ``w.turning`` = -dh/dy R^T turn(l - p) on the rotation of the
    standard error. Returns what ``reduce`` does.
    """
    dim = len(space)
    fill_rotation(space, x[dim : 3 * dim - 3], w.rotation)
    for i in range(dim):
        w.offset[i] = x[k + i] - x[i]
    for i in range(dim):
        total = 0.0
        for j in range(dim):
            total += w.rotation[j, i] * w.offset[j]
        w.point[i] = total
    predict(space, model, sensor, w)
    innovate(space, model, z, w)
    rest = reduce(space, channels(space, model), R, w)
    for a in range(dim):
        for j in range(dim):
            total = 0.0
            for i in range(dim):
                total += w.slope[a, i] * w.rotation[j, i]
            w.gain[a, j] = total
    d, G, T = w.offset, w.gain, w.turning
    for a in range(dim):
        if len(space) == 2:
            T[a, 0] = G[a, 0] * d[1] - G[a, 1] * d[0]
        else:
            T[a, 0] = G[a, 1] * d[2] - G[a, 2] * d[1]
            T[a, 1] = G[a, 2] * d[0] - G[a, 0] * d[2]
            T[a, 2] = G[a, 0] * d[1] - G[a, 1] * d[0]
    return rest


@jit()
def update(
    space: Key, x: Floats, P: Floats, n: int, k: int, model: int, sensor: Floats, z: Floats, R: Floats,
    gate: float, flag: float, invariant: bool, U: Floats, has_u: bool, A: Floats, w: Workspace,
) -> tuple[int, float]:  # fmt: skip
    """One observation of the landmark at x[k:k+dim]; returns (status, normalised innovation squared).

    H = dh/dy [-R^T, 0, ..., R^T, ...] on the invariant error, with -dh/dy R^T turn(l - p) in the rotation's
    columns on the standard one; S = H P H^T + R = L L^T; P <- P - A^T A with A = L^-1 H P.
    Rejected observations (GATED, SINGULAR) leave x and P as they were, with U still to be added.
    """
    dim, rot = len(space), 2 * len(space) - 3
    rest = linearise(space, x, k, model, sensor, z, R, w)
    G, T, S = w.gain, w.turning, w.S
    gain_columns(space, P, n, k, G, T, not invariant, A)
    if has_u:
        gain_of_prediction(space, n, k, G, U, A)
    for a in range(dim):
        for b in range(a + 1):
            total = 0.0
            for i in range(dim):
                total += G[a, i] * (A[b, k + i] - A[b, i])
            if not invariant:
                for i in range(rot):
                    total += T[a, i] * A[b, dim + i]
            S[a, b] = total + w.noise[a, b]
    if not cholesky(space, S):
        return SINGULAR, math.nan
    nis, v = 0.0, w.innovation
    for a in range(dim):
        total = v[a]
        for b in range(a):
            total -= S[a, b] * v[b]
        v[a] = total / S[a, a]
        nis += v[a] * v[a]
    nis += rest
    if not nis < math.inf:
        return SINGULAR, math.nan
    if nis > gate:
        return GATED, nis
    whiten(space, n, S, A)
    retract(space, x, n, A, v, invariant, w)
    if has_u:
        add_and_subtract(space, P, n, U, A)
    else:
        subtract(space, P, n, A)
    return (FLAGGED if nis > flag else USED), nis


@jit()
def augment(
    space: Key, x: Floats, P: Floats, n: int, model: int, sensor: Floats, z: Floats, R: Floats, invariant: bool,
    w: Workspace,
) -> bool:  # fmt: skip
    """Append the landmark that a reading shows at x[n:n+dim]; false if it is not finite.

    l = p + R y(z). xi_new = xi_p + R e on the invariant error, dp + turn(R y) dtheta + R e on the standard
    one, e the reading's noise (and the prior of what it leaves open) carried into the body frame.
    """
    dim, rot = len(space), 2 * len(space) - 3
    fill_rotation(space, x[dim : dim + rot], w.rotation)
    count = invert(space, model, sensor, z, R, w)
    turn_columns(space, w.rotation, count, w.spread, w.carried)
    size = 0.0
    for i in range(dim):
        total = 0.0
        for j in range(dim):
            total += w.rotation[i, j] * w.point[j]
        w.offset[i] = total
        size += abs(total)
        for j in range(i + 1):
            variance = 0.0
            for b in range(count):
                along = 0.0
                for a in range(count):
                    along += w.carried[j, a] * w.whitened[a, b]
                variance += w.carried[i, b] * along
            w.noise[i, j] = variance
        size += w.noise[i, i]
    if not size < math.inf:
        return False
    _append(space, x, P, n, invariant, w.offset, w.noise)
    return True


@jit()
def _append(space: Key, x: Floats, P: Floats, n: int, invariant: bool, d: Floats, W: Floats) -> None:
    """A landmark at p + d, with noise W (its lower triangle) in the outer frame."""
    dim = len(space)
    for i in range(dim):
        for j in range(n):
            P[n + i, j] = P[i, j]
    if not invariant:
        if len(space) == 2:
            for j in range(n):
                P[n, j] -= d[1] * P[2, j]
                P[n + 1, j] += d[0] * P[2, j]
        else:
            for j in range(n):
                P[n, j] += d[2] * P[4, j] - d[1] * P[5, j]
                P[n + 1, j] += d[0] * P[5, j] - d[2] * P[3, j]
                P[n + 2, j] += d[1] * P[3, j] - d[0] * P[4, j]
    for i in range(dim):
        for j in range(i + 1):
            total = P[n + i, j]
            if not invariant:
                if len(space) == 2:
                    total += (-d[1] if j == 0 else d[0]) * P[n + i, 2]
                else:
                    one, two = (j + 1) % 3, (j + 2) % 3
                    total += d[two] * P[n + i, 3 + one] - d[one] * P[n + i, 3 + two]
            P[n + i, n + j] = total + W[i, j]
            P[n + j, n + i] = P[n + i, n + j]
        for j in range(n):
            P[j, n + i] = P[n + i, j]
        x[n + i] = x[i] + d[i]
