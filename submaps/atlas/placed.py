"""One sub-map placed in a frame: its own estimate, conditioned on what the atlas knows of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.atlas.coordinates import of_rotation
from submaps.atlas.factors import factor, residual, rows_of
from submaps.geometry.small import plus, put, turn, vector
from submaps.geometry.space import Key, Pose
from submaps.submap import Submap, unpack

Floats = NDArray[np.float64]


_ADDITIVE = "float64[:, ::1](UniTuple(int64, {}), boolean, float64[::1], float64[::1], int64[::1])"


@jit(_ADDITIVE.format(2), _ADDITIVE.format(3))
def _additive(space: Key, invariant: bool, mean: Floats, packed: Floats, slots: NDArray[np.int64]) -> Floats:
    """A P A^T of the pose and the points at ``slots``, A = I plus turn(p) from the rotation to each position."""
    dim = len(space)
    pose = 3 * dim - 3
    rows = np.arange(pose + dim * slots.shape[0])
    for i in range(slots.shape[0]):
        for a in range(dim):
            rows[pose + dim * i + a] = slots[i] + a
    P = unpack(packed, rows)
    if invariant:
        for i in range(-1, slots.shape[0]):
            at = 0 if i < 0 else pose + dim * i
            columns = turn(vector(space, mean, rows[at]))
            for k in range(rows.shape[0]):
                for j in range(len(columns)):
                    put(plus(vector(space, P[k], at), P[k, dim + j], columns[j]), P[k], at)
            for j in range(len(columns)):
                for a in range(dim):
                    P[at + a] += columns[j][a] * P[dim + j]
    return 0.5 * (P + P.T)


def additive_covariance(submap: Submap, slots: list[int], with_pose: bool = False) -> Floats:
    """Covariance of the additive errors of the points at ``slots``, after the pose's if asked for.

    From the right-invariant error: dp = xi_p + turn(p) xi_theta, dtheta = xi_theta, dl = xi_l + turn(l) xi_theta.
    """
    space = submap.space
    whole = _additive(space.key, submap.invariant, submap.mean, submap.packed, np.array(slots, dtype=np.int64))
    return whole if with_pose else np.ascontiguousarray(whole[space.pose :, space.pose :])


@dataclass(frozen=True)
class Placed:
    """A sub-map's frame, end and shared landmarks in an outer frame, with their joint covariance.

    ``covariance`` (2 pose + dim s, 2 pose + dim s) is of the additive errors, in the order frame, end,
    ``shared`` landmarks (see ``geometry.space``); ``points`` (s, dim) are those landmarks.
    """

    submap: Submap
    frame: Pose
    end: Pose
    shared: list[int]
    points: Floats
    covariance: Floats

    @property
    def frame_covariance(self) -> Floats:
        """(pose, pose) of the frame."""
        pose = len(self.frame)
        return self.covariance[:pose, :pose]

    @property
    def end_covariance(self) -> Floats:
        """(pose, pose) of the end pose."""
        pose = len(self.frame)
        return self.covariance[pose : 2 * pose, pose : 2 * pose]

    @cached_property
    def _linearised(self) -> tuple[Floats, Floats, Floats]:
        """xi of the placed values against the estimate, its Jacobian, and the information."""
        submap, space = self.submap, self.submap.space
        estimate, information = factor(submap, rows_of(submap, self.shared))
        d, ends = estimate.shape[0], 2 * space.pose
        xi, J = np.empty(d), np.empty((d, ends + space.dim))
        frame, end = np.array(self.frame), np.array(self.end)
        residual(space.key, submap.invariant, estimate, frame, end, self.points, xi, J)
        whole = np.zeros((d, d + space.pose))
        whole[:, :ends] = J[:, :ends]
        for at in range(space.pose, d, space.dim):
            own = slice(at + space.pose, at + space.pose + space.dim)
            whole[at : at + space.dim, own] = J[at : at + space.dim, ends:]
        return xi, whole, information

    def landmark(self, number: int) -> tuple[Floats, Floats]:
        """Position (dim,) and covariance (dim, dim) of any landmark of the sub-map, in the outer frame.

        One that is not shared follows from the shared ones: with P split into shared s and the rest,
        xi_l = P_ls P_ss^-1 xi_s + e, e ~ P_ll - P_ls P_ss^-1 P_sl, and l = exp(xi_theta) l^ + V xi_l.
        """
        submap, space = self.submap, self.submap.space
        if number in self.shared:
            i = self.shared.index(number)
            at = slice(2 * space.pose + space.dim * i, 2 * space.pose + space.dim * (i + 1))
            return self.points[i], self.covariance[at, at]
        slot, rotation = submap.slot_of(number), slice(space.dim, space.pose)
        xi, J, information = self._linearised
        P = submap.covariance(np.concatenate([rows_of(submap, self.shared), np.arange(slot, slot + space.dim)]))
        cross = P[-space.dim :, : -space.dim]
        gain = cross @ information
        rest = P[-space.dim :, -space.dim :] - gain @ cross.T
        own, xi_l = submap.mean[slot : slot + space.dim], gain @ xi
        V, local, turned = np.eye(space.dim), own + xi_l, np.zeros((space.dim, space.rot))
        if submap.invariant:
            V = space.left_jacobian(xi[rotation])
            moved = space.rotation_of(xi[rotation]) @ own
            local = moved + V @ xi_l
            # d/dxi_theta of exp(xi_theta) l^ + V xi_l, to first order in xi_l
            turned = space.turn(moved) @ of_rotation(space, V) + 0.5 * space.turn(xi_l)
        to_outer = space.rotation(self.frame)
        A = to_outer @ (V @ gain @ J + turned @ J[rotation])
        A[:, : space.dim] += np.eye(space.dim)
        A[:, rotation] += space.turn(to_outer @ local)
        covariance = A @ self.covariance @ A.T + to_outer @ V @ rest @ V.T @ to_outer.T
        return np.array(self.frame[: space.dim]) + to_outer @ local, 0.5 * (covariance + covariance.T)
