"""Prediction: body-frame increments composed, and taken into a state; compiled, for the plane and space alike.

An increment is a pose D (the robot's next in its present frame) with the covariance of its additive errors, as
in ``geometry.space``. On the right-invariant error F = I, and a prediction is a few symmetric rank-one terms
(one in the plane, three in space) plus a change of the position's block, so that it can ride on the pass over
P which the next update makes anyway.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.filtering.layout import PENDING
from submaps.geometry import so3
from submaps.geometry.space import Key
from submaps.geometry.trig import sincos, wrap

Floats = NDArray[np.float64]

# Less of a rotation's noise than this is what rounding has left of none.
_LEAST_SHARE = 1e-14

_quaternion, _multiply, _rotation_vector = so3.quaternion, so3.multiply, so3.rotation_vector


@jit()
def accumulate(pending: Floats, noise: Floats, step: Floats, step_noise: Floats) -> None:
    """Compose one body-frame increment of the plane onto the pending one, both (3,) with covariance (3, 3).

    D <- D + (R(D_theta) v, w); the error of the composition is
    d(D) + (J R(D_theta) v, 0) d(D_theta) + diag(R(D_theta), 1) d(step). To first order this equals
    predicting with each increment in turn.
    """
    s, c = sincos(pending[2])
    v0 = c * step[0] - s * step[1]
    v1 = s * step[0] + c * step[1]
    n00 = c * c * step_noise[0, 0] - 2.0 * c * s * step_noise[0, 1] + s * s * step_noise[1, 1]
    n01 = c * s * (step_noise[0, 0] - step_noise[1, 1]) + (c * c - s * s) * step_noise[0, 1]
    n11 = s * s * step_noise[0, 0] + 2.0 * c * s * step_noise[0, 1] + c * c * step_noise[1, 1]
    n02 = c * step_noise[0, 2] - s * step_noise[1, 2]
    n12 = s * step_noise[0, 2] + c * step_noise[1, 2]
    heading, q02, q12 = noise[2, 2], noise[0, 2], noise[1, 2]
    noise[0, 0] += -2.0 * v1 * q02 + v1 * v1 * heading + n00
    noise[0, 1] += v0 * q02 - v1 * q12 - v0 * v1 * heading + n01
    noise[1, 1] += 2.0 * v0 * q12 + v0 * v0 * heading + n11
    noise[0, 2] += -v1 * heading + n02
    noise[1, 2] += v0 * heading + n12
    noise[2, 2] += step_noise[2, 2]
    noise[1, 0], noise[2, 0], noise[2, 1] = noise[0, 1], noise[0, 2], noise[1, 2]
    pending[0] += v0
    pending[1] += v1
    pending[2] = wrap(pending[2] + step[2])


@jit()
def accumulate_in_space(pending: Floats, noise: Floats, step: Floats, step_noise: Floats) -> None:
    """The same in space, (6,) with (6, 6): D <- (p + R v, R exp(r)).

    The error of the composition is d(D) + (turn(R v), 0) d(D_theta) + diag(R, R) d(step).
    """
    R, turned = np.empty((3, 3)), np.empty((6, 6))
    so3.matrix(pending[3], pending[4], pending[5], R)
    v0 = R[0, 0] * step[0] + R[0, 1] * step[1] + R[0, 2] * step[2]
    v1 = R[1, 0] * step[0] + R[1, 1] * step[1] + R[1, 2] * step[2]
    v2 = R[2, 0] * step[0] + R[2, 1] * step[1] + R[2, 2] * step[2]
    for j in range(6):  # rows, then columns, of [[I, turn(R v)], [0, I]]
        a, b, c = noise[3, j], noise[4, j], noise[5, j]
        noise[0, j] += v2 * b - v1 * c
        noise[1, j] += v0 * c - v2 * a
        noise[2, j] += v1 * a - v0 * b
    for i in range(6):
        a, b, c = noise[i, 3], noise[i, 4], noise[i, 5]
        noise[i, 0] += v2 * b - v1 * c
        noise[i, 1] += v0 * c - v2 * a
        noise[i, 2] += v1 * a - v0 * b
    rotate_noise(R, step_noise, turned)
    for i in range(6):
        for j in range(i + 1):
            noise[i, j] += turned[i, j]
            noise[j, i] = noise[i, j]
    q = _multiply(_quaternion(pending[3], pending[4], pending[5]), _quaternion(step[3], step[4], step[5]))
    pending[0] += v0
    pending[1] += v1
    pending[2] += v2
    pending[3], pending[4], pending[5] = _rotation_vector(q)


@jit()
def rotate_noise(R: Floats, Q: Floats, out: Floats) -> None:
    """out <- diag(R, R) Q diag(R, R)^T, of (6, 6) and a rotation (3, 3)."""
    room = np.empty((6, 6))
    for i in range(6):
        at = 3 * (i // 3)
        for j in range(6):
            room[i, j] = R[i - at, 0] * Q[at, j] + R[i - at, 1] * Q[at + 1, j] + R[i - at, 2] * Q[at + 2, j]
    for i in range(6):
        for j in range(6):
            at = 3 * (j // 3)
            out[i, j] = room[i, at] * R[j - at, 0] + room[i, at + 1] * R[j - at, 1] + room[i, at + 2] * R[j - at, 2]


@jit()
def predict_invariant(space: Key, x: Floats, P: Floats, n: int, pending: Floats, noise: Floats, U: Floats) -> bool:
    """Move the pose by the pending increment; leave the covariance's low-rank part in U (rot rows).

    F = I, G = [[R, -turn(p+) R], [0, R], [0, -turn(l_i) R] ...], with 1 in place of the last R in the plane.
    With Q's rotation block L L^T and X = Q_p,theta L^-T, G Q G^T = U^T U + diag(R (Q_pp - X X^T) R^T, 0 ...),
    U^T = (R X - turn(p+) R L, R L, -turn(l_i) R L ...). Returns whether U is non-zero.
    """
    if len(space) == 2:
        return _predict_plane(x, P, n, pending, noise, U[0])
    return _predict_space(x, P, n, pending, noise, U)


@jit()
def _predict_plane(x: Floats, P: Floats, n: int, pending: Floats, noise: Floats, u: Floats) -> bool:
    s, c = sincos(x[2])
    x[0] += c * pending[0] - s * pending[1]
    x[1] += s * pending[0] + c * pending[1]
    x[2] = wrap(x[2] + pending[2])
    q = noise[2, 2]
    c0 = noise[0, 2] / q if q > 0.0 else 0.0
    c1 = noise[1, 2] / q if q > 0.0 else 0.0
    q00 = max(noise[0, 0] - q * c0 * c0, 0.0)
    q11 = max(noise[1, 1] - q * c1 * c1, 0.0)
    q01 = noise[0, 1] - q * c0 * c1
    P[0, 0] += c * c * q00 - 2.0 * c * s * q01 + s * s * q11
    P[1, 1] += s * s * q00 + 2.0 * c * s * q01 + c * c * q11
    P[0, 1] += c * s * (q00 - q11) + (c * c - s * s) * q01
    P[1, 0] = P[0, 1]
    if q <= 0.0:
        return False
    root = math.sqrt(q)
    u[0] = root * (c * c0 - s * c1 + x[1])
    u[1] = root * (s * c0 + c * c1 - x[0])
    u[2] = root
    for i in range(3, n, 2):
        u[i] = root * x[i + 1]
        u[i + 1] = -root * x[i]
    return True


@jit()
def _predict_space(x: Floats, P: Floats, n: int, pending: Floats, noise: Floats, U: Floats) -> bool:
    R, Q, column = np.empty((3, 3)), np.empty((6, 6)), np.empty(6)
    so3.matrix(x[3], x[4], x[5], R)
    rotate_noise(R, noise, Q)
    for i in range(3):
        x[i] += R[i, 0] * pending[0] + R[i, 1] * pending[1] + R[i, 2] * pending[2]
    q = _multiply(_quaternion(x[3], x[4], x[5]), _quaternion(pending[3], pending[4], pending[5]))
    x[3], x[4], x[5] = _rotation_vector(q)
    found, least = False, _LEAST_SHARE * (Q[3, 3] + Q[4, 4] + Q[5, 5])
    for k in range(3):
        pivot = Q[3 + k, 3 + k]
        root = math.sqrt(pivot) if pivot > least else 0.0
        u = U[k]
        for i in range(6):  # what the rotation's k-th noise moves; the rest of Q is free of it
            column[i] = Q[i, 3 + k] / root if root > 0.0 else 0.0
        m0, m1, m2 = column[3], column[4], column[5]
        for i in range(6):
            for j in range(6):
                Q[i, j] -= column[i] * column[j]
        found = found or root > 0.0
        u[0] = column[0] - x[2] * m1 + x[1] * m2
        u[1] = column[1] + x[2] * m0 - x[0] * m2
        u[2] = column[2] - x[1] * m0 + x[0] * m1
        u[3], u[4], u[5] = m0, m1, m2
        for i in range(6, n, 3):
            u[i] = x[i + 1] * m2 - x[i + 2] * m1
            u[i + 1] = x[i + 2] * m0 - x[i] * m2
            u[i + 2] = x[i] * m1 - x[i + 1] * m0
    for i in range(3):
        for j in range(i):
            P[i, j] += Q[i, j]
            P[j, i] = P[i, j]
        P[i, i] += max(Q[i, i], 0.0)
    return found


@jit()
def predict_standard(space: Key, x: Floats, P: Floats, n: int, pending: Floats, noise: Floats) -> None:
    """The textbook prediction in O(n): F = [[I, turn(R d)], [0, I]] on the pose's rows, G = diag(R, R), in the
    plane diag(R, 1).
    """
    if len(space) == 2:
        _standard_plane(x, P, n, pending, noise)
    else:
        _standard_space(x, P, n, pending, noise)


@jit()
def _standard_plane(x: Floats, P: Floats, n: int, pending: Floats, noise: Floats) -> None:
    s, c = sincos(x[2])
    d0 = c * pending[0] - s * pending[1]
    d1 = s * pending[0] + c * pending[1]
    x[0] += d0
    x[1] += d1
    x[2] = wrap(x[2] + pending[2])
    for j in range(n):
        P[0, j] -= d1 * P[2, j]
        P[1, j] += d0 * P[2, j]
    for j in range(n):
        P[j, 0] -= d1 * P[j, 2]
        P[j, 1] += d0 * P[j, 2]
    q00, q01, q11 = noise[0, 0], noise[0, 1], noise[1, 1]
    P[0, 0] += c * c * q00 - 2.0 * c * s * q01 + s * s * q11
    P[1, 1] += s * s * q00 + 2.0 * c * s * q01 + c * c * q11
    P[0, 1] += c * s * (q00 - q11) + (c * c - s * s) * q01
    P[0, 2] += c * noise[0, 2] - s * noise[1, 2]
    P[1, 2] += s * noise[0, 2] + c * noise[1, 2]
    P[2, 2] += noise[2, 2]
    P[1, 0] = P[0, 1]
    for j in range(2, n):
        P[j, 0] = P[0, j]
        P[j, 1] = P[1, j]


@jit()
def _standard_space(x: Floats, P: Floats, n: int, pending: Floats, noise: Floats) -> None:
    R, turned = np.empty((3, 3)), np.empty((6, 6))
    so3.matrix(x[3], x[4], x[5], R)
    d0 = R[0, 0] * pending[0] + R[0, 1] * pending[1] + R[0, 2] * pending[2]
    d1 = R[1, 0] * pending[0] + R[1, 1] * pending[1] + R[1, 2] * pending[2]
    d2 = R[2, 0] * pending[0] + R[2, 1] * pending[1] + R[2, 2] * pending[2]
    for j in range(n):
        a, b, c = P[3, j], P[4, j], P[5, j]
        P[0, j] += d2 * b - d1 * c
        P[1, j] += d0 * c - d2 * a
        P[2, j] += d1 * a - d0 * b
    for j in range(n):
        a, b, c = P[j, 3], P[j, 4], P[j, 5]
        P[j, 0] += d2 * b - d1 * c
        P[j, 1] += d0 * c - d2 * a
        P[j, 2] += d1 * a - d0 * b
    rotate_noise(R, noise, turned)
    for i in range(6):
        for j in range(i, n):
            if j < 6:
                P[i, j] += turned[i, j]
            P[j, i] = P[i, j]
    x[0] += d0
    x[1] += d1
    x[2] += d2
    q = _multiply(_quaternion(x[3], x[4], x[5]), _quaternion(pending[3], pending[4], pending[5]))
    x[3], x[4], x[5] = _rotation_vector(q)


@jit()
def predict(space: Key, x: Floats, P: Floats, n: int, motion: Floats, invariant: int, U: Floats) -> bool:
    """Predict with the pending increment and clear it; whether ``U`` holds rank-one terms still to be added."""
    if not np.any(motion[PENDING:]):
        return False
    pending, noise = pending_of(space, motion)
    has_u = False
    if invariant:
        has_u = predict_invariant(space, x, P, n, pending, noise, U)
    else:
        predict_standard(space, x, P, n, pending, noise)
    motion[PENDING:] = 0.0
    return has_u


@jit()
def pending_of(space: Key, motion: Floats) -> tuple[Floats, Floats]:
    """The pending increment (pose,) and its covariance (pose, pose) in ``motion``."""
    pose = 3 * len(space) - 3
    at = PENDING + pose
    return motion[PENDING:at], motion[at : at + pose * pose].reshape(pose, pose)
