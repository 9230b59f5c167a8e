"""Which error a covariance is of: the standard one, added, or the right-invariant one.

The state is x = (p, theta, l_1, l_2, ...), an error xi = (xi_p, xi_theta, xi_1, ...) in that order,
both flat. A retraction alone tells a standard filter from an invariant one. Each gives the
derivatives that a filter needs of three things: a motion, a point as the robot sees it, and a point
that is new. ``turn(p)``, (d, t), is what a small rotation does to a point: exp(e) p = p + turn(p) e.

Whatever the error of the state, that of an increment (v, w) is e with v + e_v, exp(e_w) exp(w).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from submaps.geometry.space import PLANE
from submaps.reference.space import Geometry, outward, turned

Floats = NDArray[np.float64]


class Retraction(Protocol):
    """How an error moves a state, and what it does on the way."""

    @property
    def space(self) -> Geometry:
        """Where the robot is."""
        ...

    def plus(self, x: Floats, xi: Floats) -> Floats:
        """The state that lies xi (n,) away from x (n,)."""
        ...

    def minus(self, x: Floats, base: Floats) -> Floats:
        """xi (n,) with plus(base, xi) = x."""
        ...

    def moved(self, x: Floats, after: Floats) -> tuple[Floats, Floats]:
        """F (k, k) and G (m, k) of a motion from x to ``after``: xi+ = diag(F, I) xi + [G; 0] noise.

        k is the size of a pose; the noise is the error of the body-frame increment.
        """
        ...

    def observed(self, x: Floats, point: Floats) -> tuple[Floats, Floats]:
        """dy/dxi of y = R^T (l - p): (d, k) by the pose's error and (d, d) by the point's."""
        ...

    def shown(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """dxi_l of l = p + R y: (d, k) by the pose's error and (d, d) by that of y."""
        ...

    def additive(self, x: Floats) -> Floats:
        """T (n, n) with (dp, turn, dl_1, ...) = T xi to first order: the errors that are reported."""
        ...


def split(space: Geometry, x: Floats) -> tuple[Floats, Floats, Floats]:
    """Position (d,), rotation (t,) and points (n, d) of a state or of an error."""
    d, k = space.dim, space.pose
    return x[:d], x[d:k], x[k:].reshape(-1, d)


def joined(p: Floats, theta: Floats, points: Floats) -> Floats:
    """The state of these: ``split`` undone."""
    return np.concatenate([p, theta, points.ravel()])


def after(space: Geometry, x: Floats, increment: Floats) -> Floats:
    """The state once the robot has moved by (v, w) in its own frame: p + R v, R exp(w)."""
    p, theta, points = split(space, x)
    v, w = increment[: space.dim], increment[space.dim :]
    return joined(p + space.rotation_of(theta) @ v, turned(space, theta, w), points)


@dataclass(frozen=True)
class Standard:
    """The error of the lectures: p + xi_p, exp(xi_theta) R, l_i + xi_i. In the plane all of it is a sum."""

    space: Geometry = PLANE

    def plus(self, x: Floats, xi: Floats) -> Floats:
        """Add, and turn the rotation from the left."""
        p, theta, points = split(self.space, x)
        dp, turn, moves = split(self.space, xi)
        return joined(p + dp, turned(self.space, turn, theta), points + moves)

    def minus(self, x: Floats, base: Floats) -> Floats:
        """The differences."""
        p, theta, points = split(self.space, x)
        p0, theta0, points0 = split(self.space, base)
        return joined(p - p0, turned(self.space, theta, -theta0), points - points0)

    def moved(self, x: Floats, after: Floats) -> tuple[Floats, Floats]:
        """F = [[I, turn(p+ - p)], [0, I]], G = diag(R, R; in the plane 1): the textbook's, on the pose alone."""
        s, d = self.space, self.space.dim
        p, theta, _ = split(s, x)
        R = s.rotation_of(theta)
        F = np.eye(s.pose)
        F[:d, d:] = s.turn(after[:d] - p)
        return F, _block_diagonal(R, outward(s, R))

    def observed(self, x: Floats, point: Floats) -> tuple[Floats, Floats]:
        """[-R^T, -R^T turn(l - p)] and R^T."""
        p, theta, _ = split(self.space, x)
        back = self.space.rotation_of(theta).T
        return np.hstack([-back, -back @ self.space.turn(point - p)]), back

    def shown(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """[I, turn(R y)] and R."""
        _, theta, _ = split(self.space, x)
        R = self.space.rotation_of(theta)
        return np.hstack([np.eye(self.space.dim), self.space.turn(R @ y)]), R

    def additive(self, x: Floats) -> Floats:
        """The identity: these are the errors that are reported."""
        return np.eye(x.shape[0])


@dataclass(frozen=True)
class RightInvariant:
    """p = exp(xi_theta) p^ + V(xi_theta) xi_p, R = exp(xi_theta) R^, and each l_i as p.

    Barrau & Bonnabel, arXiv:1510.06263; in space Zhang et al., arXiv:1702.06680. What nobody can
    observe, a turn and a shift of everything, is the same direction of xi wherever the estimate is.
    """

    space: Geometry = PLANE

    def plus(self, x: Floats, xi: Floats) -> Floats:
        """Turn everything about the origin, and shift."""
        p, theta, points = split(self.space, x)
        dp, turn, moves = split(self.space, xi)
        R, V = self.space.rotation_of(turn), self.space.left_jacobian(turn)
        return joined(R @ p + V @ dp, turned(self.space, turn, theta), points @ R.T + moves @ V.T)

    def minus(self, x: Floats, base: Floats) -> Floats:
        """xi_theta from the rotations, then V^-1 (p - exp(xi_theta) p^), and each point alike."""
        p, theta, points = split(self.space, x)
        p0, theta0, points0 = split(self.space, base)
        turn = turned(self.space, theta, -theta0)
        R, V = self.space.rotation_of(turn), self.space.left_jacobian(turn)
        back = np.asarray(np.linalg.inv(V), dtype=np.float64)
        return joined(back @ (p - R @ p0), turn, (points - points0 @ R.T) @ back.T)

    def moved(self, x: Floats, after: Floats) -> tuple[Floats, Floats]:
        """F = I; G = [[R, -turn(p+) A], [0, A], [0, -turn(l_i) A], ...], A = R, in the plane 1."""
        s, d = self.space, self.space.dim
        p, _, points = split(s, after)
        R = s.rotation_of(split(s, x)[1])
        A = outward(s, R)
        G = np.zeros((x.shape[0], s.pose))
        G[:d, :d], G[d : d + s.rot, d:] = R, A
        G[:d, d:] = -s.turn(p) @ A
        for i, point in enumerate(points):
            row = s.pose + d * i
            G[row : row + d, d:] = -s.turn(point) @ A
        return np.eye(s.pose), G

    def observed(self, x: Floats, point: Floats) -> tuple[Floats, Floats]:
        """[-R^T, 0] and R^T: the heading cancels."""
        back = self.space.rotation_of(split(self.space, x)[1]).T
        return np.hstack([-back, np.zeros((back.shape[0], self.space.rot))]), back

    def shown(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """[I, 0] and R: the heading cancels."""
        R = self.space.rotation_of(split(self.space, x)[1])
        return np.hstack([np.eye(R.shape[0]), np.zeros((R.shape[0], self.space.rot))]), R

    def additive(self, x: Floats) -> Floats:
        """dp = xi_p + turn(p) xi_theta, and each point alike."""
        s, d = self.space, self.space.dim
        p, _, points = split(s, x)
        T = np.eye(x.shape[0])
        T[:d, d : d + s.rot] = s.turn(p)
        for i, point in enumerate(points):
            row = s.pose + d * i
            T[row : row + d, d : d + s.rot] = s.turn(point)
        return T


RETRACTIONS = {"standard": Standard, "invariant": RightInvariant}


def _block_diagonal(a: Floats, b: Floats) -> Floats:
    out = np.zeros((a.shape[0] + b.shape[0],) * 2)
    out[: a.shape[0], : a.shape[0]] = a
    out[a.shape[0] :, a.shape[0] :] = b
    return out
