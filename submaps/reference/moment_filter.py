"""A planar filter for range and bearing that takes whatever moments a rule gives: linear, second order, exact.

With ``moments.first_order`` it is the standard EKF. The others are the attempts of the lecture to
mend it: higher orders of the Taylor series, and exact solutions given Gaussian assumptions.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from submaps.reference.ekf import Estimate
from submaps.reference.moments import Rule, SeenRangeBearing, ShownRangeBearing

Floats = NDArray[np.float64]

_SEEN, _SHOWN = SeenRangeBearing(), ShownRangeBearing()


def augment(estimate: Estimate, z: Floats, R: Floats, rule: Rule) -> Estimate:
    """Append l = p + g(psi, z), the moments of g by ``rule``; the heading's variance has to be above 0.

    What the rest of the state has to do with g it has by way of psi: cov(s, g) = cov(s, psi) cov(psi, g) / P_psi.
    """
    x, P = estimate.x, estimate.P
    n = x.shape[0]
    spread = np.zeros((3, 3))
    spread[0, 0], spread[1:, 1:] = P[2, 2], R
    g, G, cross = rule(_SHOWN, np.array([x[2], z[0], z[1]]), spread)
    with_g = np.outer(P[:, 2], cross[0] / P[2, 2])
    grown = np.empty((n + 2, n + 2))
    grown[:n, :n] = P
    grown[:n, n:] = P[:, :2] + with_g
    grown[n:, :n] = grown[:n, n:].T
    grown[n:, n:] = P[:2, :2] + with_g[:2] + with_g[:2].T + G
    return Estimate(np.concatenate([x, x[:2] + g]), grown)


def update(estimate: Estimate, slot: int, z: Floats, R: Floats, rule: Rule) -> Estimate:
    """By one reading: W = C S^-1 with C = cov(s, h) and S = cov(h) + R as the rule says.

    h is a function of q = (l - p, psi) alone, and the state is jointly Gaussian with q:
    C = cov(s, q) cov(q)^-1 cov(q, h).
    """
    x, P = estimate.x, estimate.P
    with_q = np.column_stack([P[:, slot] - P[:, 0], P[:, slot + 1] - P[:, 1], P[:, 2]])
    spread = np.stack([with_q[slot] - with_q[0], with_q[slot + 1] - with_q[1], with_q[2]])
    q = np.array([x[slot] - x[0], x[slot + 1] - x[1], x[2]])
    expected, own, cross = rule(_SEEN, q, 0.5 * (spread + spread.T))
    C = with_q @ np.linalg.solve(spread, cross)
    S = own + R
    W = np.linalg.solve(S, C.T).T
    v = z - expected
    v[1] = math.remainder(v[1], 2.0 * math.pi)
    after = x + W @ v
    after[2] = math.remainder(after[2], 2.0 * math.pi)
    P = P - W @ S @ W.T
    return Estimate(after, 0.5 * (P + P.T))
