"""One global EKF over any number of landmarks: the compiled update in O(N²), the textbook's in O(N³)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.filtering.kernel import update
from submaps.filtering.predicting import predict_invariant
from submaps.filtering.workspace import workspace
from submaps.geometry.space import PLANE, Key
from submaps.observation.models import body_sensor

Floats = NDArray[np.float64]

A_STEP = 5  # observations a step, as the park's drive has
_LEAST_SECONDS = 0.3  # that a size is measured for


@jit(
    "void(UniTuple(int64, 2), float64[::1], float64[:, ::1], int64, float64[::1], float64[::1], float64[:, ::1],"
    "int64, int64)"
)
def _drive_compiled(
    space: Key, x: Floats, P: Floats, n: int, sensor: Floats, z: Floats, scratch: Floats, a_step: int, steps: int
) -> None:
    U, A, w = scratch[:1], scratch[1:3], workspace()
    R = np.array([[0.01, 0.0], [0.0, 0.01]])
    noise = np.diag(np.array([4e-4, 1e-4, 4e-6]))
    increment = np.zeros(3)
    for k in range(steps):
        increment[0] = 0.1 if k % 2 else -0.1
        has_u = predict_invariant(space, x, P, n, increment, noise, U)
        for i in range(a_step):
            at = (k * a_step + i) % (z.shape[0] // 2)
            update(
                space, x, P, n, 3 + 2 * at, 0, sensor, 0, z, 2 * at, R, math.inf, math.inf, True, U, has_u,
                A, False, w, w,
            )  # fmt: skip
            has_u = False


def _drive_naive(x: Floats, P: Floats, z: Floats, a_step: int, steps: int) -> None:
    """The textbook's additive EKF: dense F and H, and P <- (I - W H) P."""
    n = x.shape[0]
    R, noise = np.eye(2) * 0.01, np.diag([4e-4, 1e-4, 4e-6])
    for k in range(steps):
        d = 0.1 if k % 2 else -0.1
        c, s = math.cos(x[2]), math.sin(x[2])
        x[:2] += d * c, d * s
        F, G = np.eye(n), np.zeros((n, 3))
        F[0, 2], F[1, 2] = -d * s, d * c
        G[:3] = [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]
        P[:] = F @ P @ F.T + G @ noise @ G.T
        for i in range(a_step):
            at = (k * a_step + i) % z.shape[0]
            own = slice(3 + 2 * at, 5 + 2 * at)
            c, s = math.cos(x[2]), math.sin(x[2])
            back = np.array([[c, s], [-s, c]])
            y = back @ (x[own] - x[:2])
            H = np.zeros((2, n))
            H[:, :2], H[:, own], H[:, 2] = -back, back, (y[1], -y[0])
            W = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
            x += W @ (z[at] - y)
            P[:] = (np.eye(n) - W @ H) @ P


def _one_map(landmarks: int) -> tuple[Floats, Floats, Floats]:
    """State, dense covariance and true readings from the origin, rows up to a multiple of eight."""
    rng = np.random.default_rng(landmarks)
    n = 3 + 2 * landmarks
    rows = -(-n // 8) * 8
    x, P = np.zeros(rows), np.zeros((rows, rows))
    x[3:n] = rng.uniform(-0.5, 0.5, 2 * landmarks) * 5.0 * math.sqrt(landmarks)
    root = rng.normal(size=(n, 8)) * 0.05
    np.matmul(root, root.T, out=P[:n, :n])
    P[:n, :n] = 0.5 * (P[:n, :n] + P[:n, :n].T)
    P[np.arange(n), np.arange(n)] += 0.01
    return x, P, x[3:n].reshape(-1, 2).copy()


def _seconds_a_step(drive: Callable[[int], None]) -> float:
    """Processor time of one step, of ``drive(steps)`` with as many as take long enough."""
    drive(1)
    steps = 1
    while True:
        began = time.process_time()
        drive(steps)
        seconds = time.process_time() - began
        if seconds >= _LEAST_SECONDS:
            return seconds / steps
        steps = math.ceil(steps * min(10.0, 1.2 * _LEAST_SECONDS / max(seconds, 1e-6)))


def microseconds(landmarks: int, *, naive: bool) -> float:
    """Processor time of an observation, its share of the prediction in it."""
    x, P, z = _one_map(landmarks)
    n = 3 + 2 * landmarks
    if naive:
        whole = np.ascontiguousarray(P[:n, :n])
        seconds = _seconds_a_step(partial(_drive_naive, x[:n], whole, z, A_STEP))
    else:
        scratch, sensor = np.zeros((3, P.shape[0])), body_sensor(PLANE)
        seconds = _seconds_a_step(partial(_drive_compiled, PLANE.key, x, P, n, sensor, z.ravel(), scratch, A_STEP))
    return seconds / A_STEP * 1e6


def bytes_a_landmark(landmarks: int) -> float:
    """Of state and covariance, the latter whole, as the filter keeps it."""
    n = 3 + 2 * landmarks
    return (n * n + n) * 8 / landmarks
