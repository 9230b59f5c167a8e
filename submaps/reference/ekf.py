"""The extended Kalman filter for SLAM on any retraction: predict, augment, update.

After the lecture (COMP0130, 6A): P = F P F^T + B Q B^T; P = A P A^T + J R J^T; C = P H^T,
S = H C + R, W = C S^-1, x + W v, P - W S W^T.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from submaps.reference.observation import Observation, Sighting
from submaps.reference.retraction import Retraction, after, split

Floats = NDArray[np.float64]
# P after an update from P, H, S and W.
Form = Callable[[Floats, Floats, Floats, Floats], Floats]


@dataclass(frozen=True)
class Estimate:
    """State x (n,) and the covariance P (n, n) of its error under some retraction."""

    x: Floats
    P: Floats


def start(retraction: Retraction, pose: Floats, covariance: Floats) -> Estimate:
    """A vehicle at ``pose`` (k,) with the initial ``covariance`` (k, k) of its additive errors, and no map."""
    T = np.linalg.inv(retraction.additive(pose))
    return Estimate(pose, T @ covariance @ T.T)


def additive_covariance(retraction: Retraction, estimate: Estimate) -> Floats:
    """(n, n) covariance of the additive errors of an estimate, to first order."""
    T = retraction.additive(estimate.x)
    return np.asarray(T @ estimate.P @ T.T)


def predict(retraction: Retraction, estimate: Estimate, increment: Floats, noise: Floats) -> Estimate:
    """Move by a body-frame increment (k,) with covariance (k, k).

    F and G touch the rows that they have and no others: the standard error's prediction is O(N).
    """
    x = after(retraction.space, estimate.x, increment)
    F, G = retraction.moved(estimate.x, x)
    P = estimate.P.copy()
    k, m = F.shape[0], G.shape[0]
    P[:k] = F @ P[:k]
    P[:, :k] = P[:, :k] @ F.T
    P[:m, :m] += G @ noise @ G.T
    return Estimate(x, P)


def augment(retraction: Retraction, estimate: Estimate, z: Floats, R: Floats, model: Observation) -> Estimate:
    """Append the point that a reading z (m,) with covariance R (m, m) shows; its slot is the state's old size."""
    x, P = estimate.x, estimate.P
    space, n = retraction.space, x.shape[0]
    d, k = space.dim, space.pose
    y, noise = model.shown(z, R)
    by_pose, by_point = retraction.shown(x, y)
    grown = np.empty((n + d, n + d))
    grown[:n, :n] = P
    grown[n:, :n] = by_pose @ P[:k]
    grown[:n, n:] = grown[n:, :n].T
    grown[n:, n:] = by_pose @ P[:k, :k] @ by_pose.T + by_point @ noise @ by_point.T
    p, theta, _ = split(space, x)
    return Estimate(np.concatenate([x, p + space.rotation_of(theta) @ y]), grown)


def subtracted(P: Floats, H: Floats, S: Floats, W: Floats) -> Floats:
    """P - W S W^T, in O(N² M) for M readings."""
    return np.asarray(P - W @ S @ W.T)


def naive(P: Floats, H: Floats, S: Floats, W: Floats) -> Floats:
    """(I - W H) P as it is written, in O(N³)."""
    return np.asarray((np.eye(P.shape[0]) - W @ H) @ P)


def linearised(retraction: Retraction, x: Floats, sightings: Sequence[Sighting]) -> tuple[Floats, Floats, Floats]:
    """Innovation v (m,), H (m, n) and R (m, m) of readings taken together, all linearised at x."""
    space, n = retraction.space, x.shape[0]
    d, k = space.dim, space.pose
    p, theta, _ = split(space, x)
    back = space.rotation_of(theta).T
    innovations, rows = [], []
    for s in sightings:
        point = x[s.slot : s.slot + d]
        expected, by_y = s.model.predict(back @ (point - p))
        by_pose, by_point = retraction.observed(x, point)
        H = np.zeros((s.z.shape[0], n))
        H[:, :k] = by_y @ by_pose
        H[:, s.slot : s.slot + d] = by_y @ by_point
        innovations.append(s.model.innovation(s.z, expected))
        rows.append(H)
    noise = np.zeros((sum(len(v) for v in innovations),) * 2)
    at = 0
    for s in sightings:
        m = s.z.shape[0]
        noise[at : at + m, at : at + m] = s.R
        at += m
    return np.concatenate(innovations), np.vstack(rows), noise


def update(
    retraction: Retraction, estimate: Estimate, sightings: Sequence[Sighting], form: Form = subtracted
) -> Estimate:
    """All readings of a moment at once: x (+) W v, and P in the ``form`` asked for."""
    v, H, R = linearised(retraction, estimate.x, sightings)
    C = estimate.P @ H.T
    S = H @ C + R
    W = np.asarray(np.linalg.solve(S, C.T).T, dtype=np.float64)
    return Estimate(retraction.plus(estimate.x, W @ v), form(estimate.P, H, S, W))


def update_each(retraction: Retraction, estimate: Estimate, sightings: Sequence[Sighting]) -> Estimate:
    """Landmark by landmark: readings of a moment one after the other, each linearised where the last one led.

    Equal to the joint update where everything is linear: given the pose, the readings are independent.
    """
    for sighting in sightings:
        estimate = update(retraction, estimate, [sighting])
    return estimate
