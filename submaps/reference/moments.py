"""Mean and covariance of a function of a Gaussian: linearised, of second order, and exact.

Each rule takes f, the mean (d,) and covariance (d, d) of q, and gives the mean (m,) and covariance
(m, m) of f(q) and the cross-covariance (d, m) of q with it.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class Function(Protocol):
    """A smooth function of q (d,), with its derivatives."""

    def __call__(self, q: Floats) -> Floats:
        """f of each of (k, d) points, (k, m)."""
        ...

    def jacobian(self, q: Floats) -> Floats:
        """df/dq (m, d)."""
        ...

    def hessians(self, q: Floats) -> Floats:
        """d²f_i/dq² (m, d, d)."""
        ...


Rule = Callable[[Function, Floats, Floats], tuple[Floats, Floats, Floats]]


def first_order(f: Function, mean: Floats, P: Floats) -> tuple[Floats, Floats, Floats]:
    """f(mean), J P J^T, P J^T: the extended Kalman filter's."""
    J = f.jacobian(mean)
    return f(mean[np.newaxis])[0], J @ P @ J.T, P @ J.T


def second_order(f: Function, mean: Floats, P: Floats) -> tuple[Floats, Floats, Floats]:
    """Mean f + tr(H_i P) / 2, covariance J P J^T + tr(H_i P H_j P) / 2, cross P J^T.

    The second-order extended Kalman filter (Bar-Shalom, Li, Kirubarajan 2001, section 10.3.2).
    """
    value, covariance, cross = first_order(f, mean, P)
    HP = f.hessians(mean) @ P
    value = value + 0.5 * np.trace(HP, axis1=1, axis2=2)
    return value, covariance + 0.5 * np.einsum("iab,jba->ij", HP, HP), cross


@dataclass(frozen=True)
class Exact:
    """Moments by Gauss-Hermite quadrature, ``order`` nodes a dimension: exact for polynomials below 2 order.

    For angles of some degrees nine nodes leave nothing but rounding, so that this is the filter of
    "exact analytical solutions given Gaussian assumptions".
    """

    order: int = 9

    def __call__(self, f: Function, mean: Floats, P: Floats) -> tuple[Floats, Floats, Floats]:
        """Sums over the nodes mean + L s, P = L L^T; P has to be positive definite."""
        nodes, weights = _grid(mean.shape[0], self.order)
        deviations = nodes @ np.linalg.cholesky(P).T
        values = f(mean + deviations)
        value = weights @ values
        apart = weights[:, np.newaxis] * (values - value)
        return value, apart.T @ (values - value), deviations.T @ apart


@lru_cache(maxsize=16)
def _grid(dimension: int, order: int) -> tuple[Floats, Floats]:
    """Nodes (order^d, d) and weights of the product rule for the standard normal."""
    points, weights = np.polynomial.hermite_e.hermegauss(order)
    nodes = np.array(list(itertools.product(points, repeat=dimension)))
    products = np.prod(np.array(list(itertools.product(weights, repeat=dimension))), axis=1)
    return nodes, products / products.sum()


class SeenRangeBearing:
    """(r, beta) of q = (e, psi), e = l - p: |e| and atan2(e_y, e_x) - psi."""

    def __call__(self, q: Floats) -> Floats:
        """Bearings do not jump between the points: each is that of their centre plus what it differs."""
        e, psi = q[:, :2], q[:, 2]
        (x, y), turn = e.mean(axis=0), psi.mean()
        differs = np.arctan2(x * e[:, 1] - y * e[:, 0], x * e[:, 0] + y * e[:, 1])
        bearing = np.arctan2(y, x) - turn + differs - (psi - turn)
        return np.stack([np.hypot(e[:, 0], e[:, 1]), bearing], axis=1)

    def jacobian(self, q: Floats) -> Floats:
        """[[u^T, 0], [n^T / r, -1]], u = e / r and n = J u."""
        r, u, n = _polar(q)
        return np.array([[*u, 0.0], [*(n / r), -1.0]])

    def hessians(self, q: Floats) -> Floats:
        """n n^T / r and -(u n^T + n u^T) / r² on e; psi enters linearly."""
        r, u, n = _polar(q)
        out = np.zeros((2, 3, 3))
        out[0, :2, :2] = np.outer(n, n) / r
        out[1, :2, :2] = -(np.outer(u, n) + np.outer(n, u)) / (r * r)
        return out


class ShownRangeBearing:
    """The offset r (cos a, sin a), a = psi + beta, of q = (psi, r, beta): where a new landmark lies from the robot."""

    def __call__(self, q: Floats) -> Floats:
        """Of each point."""
        angle = q[:, 0] + q[:, 2]
        return np.asarray(q[:, 1:2] * np.stack([np.cos(angle), np.sin(angle)], axis=1))

    def jacobian(self, q: Floats) -> Floats:
        """Columns r n, u, r n."""
        u, n = _along(q)
        return np.stack([q[1] * n, u, q[1] * n], axis=1)

    def hessians(self, q: Floats) -> Floats:
        """d²/da² = -r u, d²/dr da = n."""
        u, n = _along(q)
        out = np.zeros((2, 3, 3))
        for a, b in itertools.product((0, 2), repeat=2):
            out[:, a, b] = -q[1] * u
        for a in (0, 2):
            out[:, a, 1] = out[:, 1, a] = n
        return out


def _polar(q: Floats) -> tuple[float, Floats, Floats]:
    r = float(np.hypot(q[0], q[1]))
    u = q[:2] / r
    return r, u, np.array([-u[1], u[0]])


def _along(q: Floats) -> tuple[Floats, Floats]:
    c, s = np.cos(q[0] + q[2]), np.sin(q[0] + q[2])
    return np.array([c, s]), np.array([-s, c])
