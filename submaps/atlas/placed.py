"""One sub-map placed in a frame: its own estimate, conditioned on what the atlas knows of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from submaps.atlas.factors import factor, residual, rows_of
from submaps.geometry.se2 import Pose
from submaps.geometry.trig import rotation_series, sincos
from submaps.submap import Submap

Floats = NDArray[np.float64]
_J = np.array([[0.0, -1.0], [1.0, 0.0]])


def rotation(theta: float) -> Floats:
    """(2, 2) matrix of a rotation by theta (rad)."""
    s, c = sincos(theta)
    return np.array([[c, -s], [s, c]])


def as_pose(values: Floats) -> Pose:
    """A pose (x m, y m, theta rad) from an array (3,)."""
    return float(values[0]), float(values[1]), float(values[2])


def additive_covariance(submap: Submap, slots: list[int], with_pose: bool = False) -> Floats:
    """Covariance of the additive errors of the points at ``slots``, after the pose's if asked for.

    From the right-invariant error: dp = xi_p + J p xi_theta, dtheta = xi_theta, dl = xi_l + J l xi_theta.
    """
    rows = np.array([0, 1, 2, *(r for k in slots for r in (k, k + 1))], dtype=np.int64)
    P = submap.covariance(rows)
    A = np.eye(rows.shape[0])
    if submap.invariant:
        for i, k in enumerate([0, *slots]):
            at = 0 if i == 0 else 3 + 2 * (i - 1)
            A[at, 2] -= submap.mean[k + 1]
            A[at + 1, 2] += submap.mean[k]
    whole = A @ P @ A.T
    whole = 0.5 * (whole + whole.T)
    return whole if with_pose else np.ascontiguousarray(whole[3:, 3:])


@dataclass(frozen=True)
class Placed:
    """A sub-map's frame, end and shared landmarks in an outer frame, with their joint covariance.

    ``covariance`` (6 + 2s, 6 + 2s) is of the additive errors, in the order frame (x, y, theta), end
    (x, y, theta), ``shared`` landmarks (x, y each).
    """

    submap: Submap
    frame: Pose
    end: Pose
    shared: list[int]
    points: Floats
    covariance: Floats

    @property
    def frame_covariance(self) -> Floats:
        """(3, 3) of the frame."""
        return self.covariance[:3, :3]

    @property
    def end_covariance(self) -> Floats:
        """(3, 3) of the end pose."""
        return self.covariance[3:6, 3:6]

    @cached_property
    def _linearised(self) -> tuple[Floats, Floats, Floats]:
        """xi of the placed values against the estimate, its Jacobian, and the information."""
        estimate, information = factor(self.submap, rows_of(self.submap, self.shared))
        xi = np.empty(estimate.shape[0])
        J = np.empty((estimate.shape[0], 8))
        residual(self.submap.invariant, estimate, np.array(self.frame), np.array(self.end), self.points, xi, J)
        whole = np.zeros((xi.shape[0], xi.shape[0] + 3))
        whole[:, :6] = J[:, :6]
        for i in range(len(self.shared)):
            whole[3 + 2 * i : 5 + 2 * i, 6 + 2 * i : 8 + 2 * i] = J[3 + 2 * i : 5 + 2 * i, 6:]
        return xi, whole, information

    def landmark(self, number: int) -> tuple[Floats, Floats]:
        """Position (2,) and covariance (2, 2) of any landmark of the sub-map, in the outer frame.

        One that is not shared follows from the shared ones: with P split into shared s and the rest,
        xi_l = P_ls P_ss^-1 xi_s + e, e ~ P_ll - P_ls P_ss^-1 P_sl, and l = R(xi_theta) l^ + V xi_l.
        """
        if number in self.shared:
            i = self.shared.index(number)
            return self.points[i], self.covariance[6 + 2 * i : 8 + 2 * i, 6 + 2 * i : 8 + 2 * i]
        submap, slot = self.submap, self.submap.slot_of(number)
        xi, J, information = self._linearised
        rows = np.concatenate([rows_of(submap, self.shared), [slot, slot + 1]])
        P = submap.covariance(rows)
        cross = P[-2:, :-2]
        gain = cross @ information
        rest = P[-2:, -2:] - gain @ cross.T
        own = submap.mean[slot : slot + 2]
        by_xi = gain @ J
        V, local, turned = np.eye(2), own + gain @ xi, np.zeros(2)
        if submap.invariant:
            a, b = rotation_series(float(xi[2]))
            V, R = np.array([[a, -b], [b, a]]), rotation(float(xi[2]))
            local = R @ own + V @ (gain @ xi)
            # d/dxi_theta of R l^ + V xi_l, to first order in xi_l
            turned = _J @ R @ own + 0.5 * _J @ (gain @ xi)
        to_outer = rotation(self.frame[2])
        A = to_outer @ (V @ by_xi + np.outer(turned, J[2]))
        A[:, :2] += np.eye(2)
        A[:, 2] += _J @ to_outer @ local
        covariance = A @ self.covariance @ A.T + to_outer @ V @ rest @ V.T @ to_outer.T
        return np.array(self.frame[:2]) + to_outer @ local, 0.5 * (covariance + covariance.T)
