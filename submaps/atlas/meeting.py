"""Components that meet: what they share is aligned in closed form, and tested before it ties them.

Two components are told apart by nothing but a rigid motion T. At least two landmarks that both hold,
further apart than 3 sigma, give it; what is left, r = a - T b, has to fit its covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from submaps.atlas.component import Component
from submaps.atlas.placed import as_pose, rotation
from submaps.atlas.solution import Untied, factorised
from submaps.atlas.tie import fit
from submaps.consistency import chi_square_bound
from submaps.geometry.se2 import Pose

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_APART_SIGMAS = 3.0
# The rigid motion has three unknowns: a few dozen landmarks determine it.
_MOST_LANDMARKS = 40
_MOST_PAIRS = 60
# Without a gate every sighting is used, so that all of them have to fit together.
_UNGATED = 0.9999


@dataclass(frozen=True)
class Meeting:
    """How the second component lies in the first.

    ``untied`` are the second one's pairs (sub-map, landmark) that do not agree; the joint solve may
    cost at most ``most_cost`` more than the two alone.
    """

    transform: Pose
    untied: Untied
    most_cost: float


@dataclass(frozen=True)
class _Points:
    """Landmarks (n, 2) in both components' frames, with their joint covariances (2n, 2n)."""

    a: Floats
    b: Floats
    cov_a: Floats
    cov_b: Floats

    def only(self, which: Ints) -> _Points:
        rows = (2 * which[:, np.newaxis] + np.arange(2)).ravel()
        inside = np.ix_(rows, rows)
        return _Points(
            *(np.ascontiguousarray(v) for v in (self.a[which], self.b[which], self.cov_a[inside], self.cov_b[inside]))
        )

    def fit(self) -> tuple[Floats, Floats] | None:
        """T (3,) and its covariance (3, 3) by weighted least squares."""
        T, covariance = np.empty(3), np.empty((3, 3))
        return (T, covariance) if fit(self.a, self.b, self.cov_a, self.cov_b, T, covariance) else None

    def left(self, T: Floats) -> tuple[Floats, Floats]:
        """r = a - T b (n, 2) and its covariance (2n, 2n)."""
        R = rotation(float(T[2]))
        turn = np.kron(np.eye(self.a.shape[0]), R)
        return self.a - self.b @ R.T - T[:2], self.cov_a + turn @ self.cov_b @ turn.T


def meet(a: Component, b: Component, gate: float | None) -> Meeting | None:
    """How ``b`` lies in ``a``, or ``None`` where they share too little or it does not fit."""
    common, rows_a, rows_b = np.intersect1d(a.landmarks, b.landmarks, return_indices=True)
    chosen = np.unique(np.linspace(0, common.shape[0] - 1, min(common.shape[0], _MOST_LANDMARKS)).astype(np.int64))
    points = _Points(
        a.points[rows_a[chosen]], b.points[rows_b[chosen]], _joint(a, rows_a[chosen]), _joint(b, rows_b[chosen])
    )
    pairs = _apart(points)
    if pairs.shape[0] == 0:
        return None
    fitting = np.arange(chosen.shape[0]) if gate is None else _consensus(points, pairs, gate)
    while fitting.shape[0] >= 2 and 2 * fitting.shape[0] > chosen.shape[0]:
        some = points.only(fitting)
        found = some.fit()
        if found is None or _apart(some).shape[0] == 0:
            return None
        r, C = some.left(found[0])
        if _squared(r.ravel(), C) <= chi_square_bound(gate or _UNGATED, 2 * fitting.shape[0] - 3):
            wrong = np.setdiff1d(chosen, chosen[fitting])
            sampled = chosen.shape[0] < common.shape[0]
            most = np.inf if sampled and gate else chi_square_bound(_UNGATED, 2 * common.shape[0] - 3)
            return Meeting(as_pose(found[0]), _pairs_of(b, common[wrong]), most)
        if gate is None:
            return None
        fitting = np.delete(fitting, np.argmax(_squares(r, C)))
    return None


def _joint(component: Component, rows: Ints) -> Floats:
    """Covariance (2n, 2n) of landmarks by their rows of ``points``."""
    factor = factorised(component)
    start = component.pattern.start
    entries = (start[component.poses + rows][:, np.newaxis] + np.arange(2)).ravel()
    covariance = np.empty((entries.shape[0],) * 2)
    for i, entry in enumerate(entries):
        unit = np.zeros(component.pattern.size)
        unit[entry] = 1.0
        covariance[:, i] = factor.solve(unit)[entries]
    return 0.5 * (covariance + covariance.T)


def _apart(points: _Points) -> Ints:
    """Pairs (k, 2) of landmarks further apart than 3 sigma in both components, the farthest first."""
    i, j = np.triu_indices(points.a.shape[0], 1)
    good = np.ones(i.shape[0], dtype=bool)
    for at, covariance in ((points.a, points.cov_a), (points.b, points.cov_b)):
        blocks = covariance.reshape(at.shape[0], 2, at.shape[0], 2).transpose(0, 2, 1, 3)
        spread = blocks[i, i] + blocks[j, j] - blocks[i, j] - blocks[j, i]
        sigma = np.sqrt(np.linalg.eigvalsh(spread)[:, -1])
        good &= np.hypot(*(at[i] - at[j]).T) > _APART_SIGMAS * sigma
    order = np.argsort(-np.hypot(*(points.a[i] - points.a[j]).T), kind="stable")
    order = order[good[order]]
    return np.stack([i[order], j[order]], axis=1)


def _consensus(points: _Points, pairs: Ints, gate: float) -> Ints:
    """The largest set of landmarks that agrees with the motion which some pair gives."""
    best: Ints = np.empty(0, dtype=np.int64)
    for pair in pairs[:_MOST_PAIRS]:
        found = points.only(pair).fit()
        if found is None:
            continue
        T, covariance = found
        r, C = points.left(T)
        moved = points.a - r
        by_T = np.zeros((r.shape[0], 2, 3))
        by_T[:, 0, 0] = by_T[:, 1, 1] = 1.0
        by_T[:, 0, 2], by_T[:, 1, 2] = T[1] - moved[:, 1], moved[:, 0] - T[0]
        inside = np.flatnonzero(_squares(r, C, by_T @ covariance @ by_T.transpose(0, 2, 1)) < chi_square_bound(gate, 2))
        inside = np.union1d(inside, pair)
        if inside.shape[0] > best.shape[0]:
            best = inside
    return best


def _squares(r: Floats, C: Floats, more: Floats | float = 0.0) -> Floats:
    """Squared Mahalanobis distance of each point alone."""
    n = r.shape[0]
    blocks = C.reshape(n, 2, n, 2)[np.arange(n), :, np.arange(n), :] + more
    return np.asarray(np.einsum("ni,ni->n", r, np.linalg.solve(blocks, r[:, :, np.newaxis])[:, :, 0]))


def _squared(r: Floats, C: Floats) -> float:
    return float(r @ np.linalg.solve(C, r))


def _pairs_of(component: Component, landmarks: Ints) -> Untied:
    """The pairs (sub-map, landmark) of a component's members that share any of the landmarks."""
    wanted = set(landmarks.tolist())
    if not wanted:
        return frozenset()
    return frozenset((s.number, i) for f, s in enumerate(component.members) for i in component.shared(f) if i in wanted)
