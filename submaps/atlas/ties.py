"""Ties that are checked: a first sighting cannot be gated, so it is held against the joined map.

A factor says of its landmark i, given the rest of what it says, r = S_0 (Lambda xi)_i with covariance
S_0 = Lambda_ii^-1: a measurement independent of all others. In the solution, which used it, r has the
covariance S_0 - A C A^T (A = dr/dx, C that of the factor's variables), and r^T (S_0 - A C A^T)^-1 r is
the normalised innovation squared against a map made without it.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.atlas.cholesky import cholesky
from submaps.atlas.cholesky import information as invert
from submaps.atlas.component import Component
from submaps.atlas.coordinates import transformed
from submaps.atlas.factors import residual
from submaps.atlas.placed import Placed, additive_covariance
from submaps.atlas.solution import Untied, factorised
from submaps.atlas.sparse import InverseSubset
from submaps.geometry.space import Key

Floats = NDArray[np.float64]

# Below this share of its own covariance, what is left of it tells nothing: no other tie holds the landmark.
_LEAST_REDUNDANCY = 1e-6
# The share of the worst innovation nearby from which on others are taken to be wrong by themselves.
_OUTSTANDING = 0.25
# How far along a chain a wrong tie is felt, and by how few holders of its landmark.
_NEAR_STEPS, _FEW = 3, 4
# With more holders than this a newcomer does not outvote them.
_MOST_VOTERS = 16


@jit()
def _times(a: Floats, b: Floats, out: Floats) -> None:
    """out <- a b."""
    out[:] = 0.0
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            factor = a[i, k]
            for j in range(b.shape[1]):
                out[i, j] += factor * b[k, j]


@jit()
def _is_redundant(S: Floats, M: Floats) -> bool:
    """Whether enough of a covariance is left, by the leading minors of both, whose Cholesky factors these are."""
    share, least = 1.0, 1.0
    for a in range(S.shape[0]):
        share *= (M[a, a] / S[a, a]) ** 2
        least *= _LEAST_REDUNDANCY
        if not share > least:
            return False
    return True


@jit()
def _squared_length(L: Floats, r: Floats) -> float:
    """|L^-1 r|^2; destroys r."""
    total = 0.0
    for a in range(r.shape[0]):
        for b in range(a):
            r[a] -= L[a, b] * r[b]
        r[a] /= L[a, a]
        total += r[a] * r[a]
    return total


_TIE_NIS = "void(UniTuple(int64, {}), float64[:, ::1], float64[::1], float64[:, ::1], float64[:, ::1], float64[::1])"


@jit(_TIE_NIS.format(2), _TIE_NIS.format(3))
def tie_nis(space: Key, information: Floats, xi: Floats, J: Floats, C: Floats, out: Floats) -> None:
    """``out`` (s,) <- normalised innovation squared of each shared landmark of a factor.

    ``information`` (d, d), ``xi`` (d,) and J (d, 2 pose + dim) as in ``atlas.factors``; C (pose + d, pose + d)
    the covariance of the factor's variables. Zero where nothing else determines the landmark.
    """
    dim = len(space)
    pose = 3 * dim - 3
    ends, d, size = 2 * pose, xi.shape[0], C.shape[0]
    S, M, own = np.empty((dim, dim)), np.empty((dim, dim)), np.empty((dim, dim))
    by, A, AC = np.empty((dim, size)), np.empty((dim, size)), np.empty((dim, size))
    weighted, r = np.empty(dim), np.empty(dim)
    for i in range(out.shape[0]):
        k = pose + dim * i
        by[:] = 0.0
        weighted[:] = 0.0
        for a in range(dim):
            for b in range(dim):
                own[a, b] = information[k + a, k + b]
            for m in range(d):
                w = information[k + a, m]
                weighted[a] += w * xi[m]
                for c in range(ends):
                    by[a, c] += w * J[m, c]
                if m >= pose:
                    column = ends + dim * ((m - pose) // dim)
                    for c in range(dim):
                        by[a, column + c] += w * J[m, ends + c]
        out[i] = 0.0
        if not invert(own, S):
            continue
        _times(S, by, A)
        _times(A, C, AC)
        for a in range(dim):
            r[a] = 0.0
            for b in range(dim):
                r[a] += S[a, b] * weighted[b]
                M[a, b] = S[a, b]
                for c in range(size):
                    M[a, b] -= AC[a, c] * A[b, c]
        if cholesky(S) and cholesky(M) and _is_redundant(S, M):
            out[i] = _squared_length(M, r)


def innovations(component: Component, placed: Placed) -> Floats:
    """Normalised innovation squared (s,) of a member's shared landmarks, each against the map without it."""
    _, _, estimate, information = component.parts[component.at(placed.submap.number)]
    space, d = component.space, estimate.shape[0]
    xi, J = np.empty(d), np.empty((d, 2 * space.pose + space.dim))
    frame, end = np.array(placed.frame), np.array(placed.end)
    residual(space.key, placed.submap.invariant, estimate, frame, end, placed.points, xi, J)
    out = np.empty(len(placed.shared))
    tie_nis(space.key, information, xi, J, np.ascontiguousarray(placed.covariance), out)
    return out


def checked(component: Component, members: Iterable[int], untied: Untied, bound: float) -> Untied:
    """``untied`` after the ties of these members were checked.

    One that is wrong makes its neighbours look so: what stands out far less than one nearby waits
    until that is gone, and so does what shares a sub-map or a landmark with a worse one.
    """
    inverse = factorised(component).inverse_subset()
    found: list[tuple[float, int, int]] = []
    for f in members:
        shared = component.shared(f)
        if shared:
            nis = innovations(component, component.placed(component.members[f].number, inverse))
            found += [(float(nis[i]), f, shared[i]) for i in np.flatnonzero(nis > bound)]
    worst: dict[int, float] = {}  # near a member, the worst first
    touched: set[tuple[str, int]] = set()
    for nis_, f, landmark in sorted(found, reverse=True):
        holders = component.holders(landmark)
        alone = len(holders) > _FEW  # the many others hardly feel it
        places = {("member", f)} if alone else {("member", f), ("landmark", landmark)}
        if nis_ >= _OUTSTANDING * worst.get(f, 0.0) and not places & touched:
            untied = _voted(component, inverse, landmark, f, untied, bound)
        touched |= places
        for holder in [f] if alone else holders:
            for member in component.near(holder, _NEAR_STEPS):
                worst.setdefault(member, nis_)
    return untied


def readmitted(component: Component, lately: Untied, untied: Untied, bound: float) -> Untied:
    """``untied`` without those pairs of ``lately`` that agree with the map as it now is."""
    inverse = factorised(component).inverse_subset()
    again = set()
    for number, landmark in sorted(lately & untied):
        if not component.has(number):
            continue
        at, covariance = _as_seen(component, inverse, landmark, component.at(number))
        others = [k for k in component.holders(landmark) if (component.members[k].number, landmark) not in untied]
        seen = [_as_seen(component, inverse, landmark, k) for k in others[-_MOST_VOTERS:]]
        if seen and all(_squared(at - other, covariance + its) <= bound for other, its in seen):
            again.add((number, landmark))
    return untied - again


def _squared(d: Floats, covariance: Floats) -> float:
    return float(d @ np.linalg.solve(covariance, d))


def _voted(component: Component, inverse: InverseSubset, landmark: int, f: int, untied: Untied, bound: float) -> Untied:
    """``untied`` with a landmark's holders parted: the largest set of them that agrees keeps its ties."""
    holders = component.holders(landmark)
    tied = {k for k in holders if (component.members[k].number, landmark) not in untied and k != f}
    if len(holders) == 2:
        tied = {holders[0]}  # either way neither has the other any more
    if 2 < len(holders) <= _MOST_VOTERS:
        agreeing = _largest_agreeing(component, inverse, landmark, holders, tied, bound)
        if len(agreeing) > len(tied):
            tied = agreeing
    mine = {(component.members[k].number, landmark) for k in holders}
    kept = {(component.members[k].number, landmark) for k in tied}
    return (untied - mine) | (mine - kept)


def _largest_agreeing(
    component: Component, inverse: InverseSubset, landmark: int, holders: list[int], tied: set[int], bound: float
) -> set[int]:
    """The largest set of holders that place the landmark alike, those tied preferred."""
    seen = [_as_seen(component, inverse, landmark, k) for k in holders]
    best: set[int] = set()
    for at, covariance in seen:
        agreeing = set()
        for k, (other, its) in zip(holders, seen, strict=True):
            if _squared(other - at, covariance + its) <= bound:
                agreeing.add(k)
        if (len(agreeing), len(agreeing & tied)) > (len(best), len(best & tied)):
            best = agreeing
    return best


def _as_seen(component: Component, inverse: InverseSubset, landmark: int, f: int) -> tuple[Floats, Floats]:
    """Where a member's own estimate puts a landmark (dim,), and its covariance (dim, dim)."""
    submap = component.members[f]
    slot, placed = submap.slot_of(landmark), component.placed(submap.number, inverse)
    own, by_itself = submap.mean[slot : slot + component.space.dim], additive_covariance(submap, [slot])
    return transformed(component.space, placed.frame, placed.frame_covariance, own, by_itself)
