"""Components that meet: what they share is aligned in closed form, and tested before it ties them.

Two components are told apart by nothing but a rigid motion T. At least two landmarks that both hold,
further apart than 3 sigma, give it; in space three, no two of which lie that near to each other and none
that near to the line through the others. What is left, r = a - T b, has to fit its covariance.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from submaps.atlas.component import Component
from submaps.atlas.coordinates import turns
from submaps.atlas.solution import Untied, factorised
from submaps.atlas.tie import fit
from submaps.consistency import chi_square_bound
from submaps.geometry.space import Pose, Space

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_APART_SIGMAS = 3.0
# The rigid motion has three unknowns: a few dozen landmarks determine it.
_MOST_LANDMARKS = 40
_MOST_SAMPLES = 60
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
    """Landmarks (n, dim) in both components' frames, with their joint covariances (dim n, dim n)."""

    space: Space
    a: Floats
    b: Floats
    cov_a: Floats
    cov_b: Floats

    def only(self, which: Ints) -> _Points:
        rows = (self.space.dim * which[:, np.newaxis] + np.arange(self.space.dim)).ravel()
        inside = np.ix_(rows, rows)
        kept = (self.a[which], self.b[which], self.cov_a[inside], self.cov_b[inside])
        return _Points(self.space, *(np.ascontiguousarray(v) for v in kept))

    def fit(self) -> tuple[Floats, Floats] | None:
        """T (pose,) and its covariance (pose, pose) by weighted least squares."""
        pose = self.space.pose
        T, covariance = np.empty(pose), np.empty((pose, pose))
        fitted = fit(self.space.key, self.a, self.b, self.cov_a, self.cov_b, T, covariance)
        return (T, covariance) if fitted else None

    def left(self, T: Floats) -> tuple[Floats, Floats]:
        """r = a - T b (n, dim) and its covariance (dim n, dim n)."""
        R = self.space.rotation(T)
        turn = np.kron(np.eye(self.a.shape[0]), R)
        return self.a - self.b @ R.T - T[: self.space.dim], self.cov_a + turn @ self.cov_b @ turn.T


def meet(a: Component, b: Component, gate: float | None) -> Meeting | None:
    """How ``b`` lies in ``a``, or ``None`` where they share too little or it does not fit."""
    common, rows_a, rows_b = np.intersect1d(a.landmarks, b.landmarks, return_indices=True)
    chosen = np.unique(np.linspace(0, common.shape[0] - 1, min(common.shape[0], _MOST_LANDMARKS)).astype(np.int64))
    chosen_a, chosen_b, space = rows_a[chosen], rows_b[chosen], a.space
    points = _Points(space, a.points[chosen_a], b.points[chosen_b], _joint(a, chosen_a), _joint(b, chosen_b))
    apart = _apart(points)
    if apart.shape[0] == 0:
        return None
    fitting = np.arange(chosen.shape[0]) if gate is None else _consensus(points, apart, gate)
    while fitting.shape[0] >= space.dim and 2 * fitting.shape[0] > chosen.shape[0]:
        some = points.only(fitting)
        found = some.fit()
        if found is None or _apart(some).shape[0] == 0:
            return None
        r, C = some.left(found[0])
        if _squared(r.ravel(), C) <= chi_square_bound(gate or _UNGATED, r.size - space.pose):
            wrong = np.setdiff1d(chosen, chosen[fitting])
            sampled = chosen.shape[0] < common.shape[0]
            freedom = space.dim * common.shape[0] - space.pose
            most = np.inf if sampled and gate else chi_square_bound(_UNGATED, freedom)
            return Meeting(space.as_pose(found[0]), _pairs_of(b, common[wrong]), most)
        if gate is None:
            return None
        fitting = np.delete(fitting, np.argmax(_squares(r, C)))
    return None


def _joint(component: Component, rows: Ints) -> Floats:
    """Covariance (dim n, dim n) of landmarks by their rows of ``points``."""
    factor = factorised(component)
    start = component.pattern.start
    entries = (start[component.poses + rows][:, np.newaxis] + np.arange(component.space.dim)).ravel()
    covariance = np.empty((entries.shape[0],) * 2)
    for i, entry in enumerate(entries):
        unit = np.zeros(component.pattern.size)
        unit[entry] = 1.0
        covariance[:, i] = factor.solve(unit)[entries]
    return 0.5 * (covariance + covariance.T)


def _apart(points: _Points) -> Ints:
    """Landmarks (k, dim) that give the motion in both components, the farthest apart first.

    Pairs further apart than 3 sigma; in space triangles whose least height is more than 3 times the
    largest sigma of their sides.
    """
    dim, n = points.space.dim, points.a.shape[0]
    corners = np.array(list(combinations(range(n), dim)), dtype=np.int64).reshape(-1, dim)
    good = np.ones(corners.shape[0], dtype=bool)
    for at, covariance in ((points.a, points.cov_a), (points.b, points.cov_b)):
        sigma = _sigmas(covariance.reshape(n, dim, n, dim))
        widest = np.max([sigma[i, j] for i, j in combinations(corners.T, 2)], axis=0)
        good &= _width(at, corners) > _APART_SIGMAS * widest
    order = np.argsort(-_width(points.a, corners), kind="stable")
    return corners[order[good[order]]]


def _width(points: Floats, corners: Ints) -> Floats:
    """The distance of each pair of points, or the least height of each triangle."""
    sides = [points[corners[:, i]] - points[corners[:, j]] for i, j in combinations(range(corners.shape[1]), 2)]
    longest = np.max([np.linalg.norm(side, axis=1) for side in sides], axis=0)
    if len(sides) == 1:
        return np.asarray(longest)
    return np.asarray(np.linalg.norm(np.cross(sides[0], sides[1]), axis=1) / np.where(longest > 0.0, longest, 1.0))


def _sigmas(covariance: Floats) -> Floats:
    """Largest standard deviation (n, n), in any direction, of how each point (n, dim) lies to each other one."""
    n = covariance.shape[0]
    C, (i, j) = covariance.transpose(0, 2, 1, 3), np.triu_indices(n, 1)
    out = np.zeros((n, n))
    out[i, j] = np.sqrt(np.linalg.eigvalsh(C[i, i] + C[j, j] - C[i, j] - C[j, i])[:, -1])
    return out


def _consensus(points: _Points, apart: Ints, gate: float) -> Ints:
    """The largest set of landmarks that agrees with the motion which some few give."""
    best: Ints = np.empty(0, dtype=np.int64)
    dim = points.space.dim
    for few in _sample(apart):
        found = points.only(few).fit()
        if found is None:
            continue
        T, covariance = found
        r, C = points.left(T)
        n = r.shape[0]
        by_T = np.concatenate([np.tile(np.eye(dim), (n, 1)), turns(points.space, points.a - r - T[:dim])], axis=1)
        by_T = by_T.reshape(n, dim, -1)
        within = _squares(r, C, by_T @ covariance @ by_T.transpose(0, 2, 1)) < chi_square_bound(gate, dim)
        inside = np.union1d(np.flatnonzero(within), few)
        if inside.shape[0] > best.shape[0]:
            best = inside
    return best


def _sample(apart: Ints) -> Ints:
    """The farthest pairs; triangles of every size, for a single wrong landmark is part of most of the largest."""
    if apart.shape[1] == 2:
        return apart[:_MOST_SAMPLES]
    return apart[np.unique(np.linspace(0, len(apart) - 1, min(len(apart), _MOST_SAMPLES)).astype(np.int64))]


def _squares(r: Floats, C: Floats, more: Floats | float = 0.0) -> Floats:
    """Squared Mahalanobis distance of each point alone."""
    n, dim = r.shape
    blocks = C.reshape(n, dim, n, dim)[np.arange(n), :, np.arange(n), :] + more
    return np.asarray(np.einsum("ni,ni->n", r, np.linalg.solve(blocks, r[:, :, np.newaxis])[:, :, 0]))


def _squared(r: Floats, C: Floats) -> float:
    return float(r @ np.linalg.solve(C, r))


def _pairs_of(component: Component, landmarks: Ints) -> Untied:
    """The pairs (sub-map, landmark) of a component's members that share any of the landmarks."""
    wanted = set(landmarks.tolist())
    if not wanted:
        return frozenset()
    return frozenset((s.number, i) for f, s in enumerate(component.members) for i in component.shared(f) if i in wanted)
