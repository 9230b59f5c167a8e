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
from submaps.atlas.component import Component
from submaps.atlas.factors import residual
from submaps.atlas.placed import Placed, additive_covariance, rotation
from submaps.atlas.solution import Untied, factorised
from submaps.atlas.sparse import InverseSubset
from submaps.geometry.se2 import transform

Floats = NDArray[np.float64]

# Below this share of its own covariance, what is left of it tells nothing: no other tie holds the landmark.
_LEAST_REDUNDANCY = 1e-6
# The share of the worst innovation nearby from which on others are taken to be wrong by themselves.
_OUTSTANDING = 0.25
# How far along a chain a wrong tie is felt, and by how few holders of its landmark.
_NEAR_STEPS, _FEW = 3, 4
# With more holders than this a newcomer does not outvote them.
_MOST_VOTERS = 16


@jit("void(float64[:, ::1], float64[::1], float64[:, ::1], float64[:, ::1], float64[::1])")
def tie_nis(information: Floats, xi: Floats, J: Floats, C: Floats, out: Floats) -> None:
    """``out`` (s,) <- normalised innovation squared of each shared landmark of a factor.

    ``information`` (d, d), ``xi`` (d,) and J (d, 8) as in ``atlas.factors``; C (6 + 2s, 6 + 2s) the
    covariance of the factor's variables. Zero where nothing else determines the landmark.
    """
    d, size = xi.shape[0], C.shape[0]
    A = np.empty((2, size))
    for i in range(out.shape[0]):
        k = 3 + 2 * i
        l00, l01, l11 = information[k, k], information[k, k + 1], information[k + 1, k + 1]
        det = l00 * l11 - l01 * l01
        s00, s01, s11 = l11 / det, -l01 / det, l00 / det
        w0 = w1 = 0.0
        A[:] = 0.0
        for m in range(d):
            a0, a1 = information[k, m], information[k + 1, m]
            w0 += a0 * xi[m]
            w1 += a1 * xi[m]
            for c in range(6):
                A[0, c] += a0 * J[m, c]
                A[1, c] += a1 * J[m, c]
            if m >= 3:
                column = 6 + 2 * ((m - 3) // 2)
                for c in range(2):
                    A[0, column + c] += a0 * J[m, 6 + c]
                    A[1, column + c] += a1 * J[m, 6 + c]
        r0, r1 = s00 * w0 + s01 * w1, s01 * w0 + s11 * w1
        for c in range(size):
            a0, a1 = A[0, c], A[1, c]
            A[0, c], A[1, c] = s00 * a0 + s01 * a1, s01 * a0 + s11 * a1
        m00, m01, m11 = s00, s01, s11
        for p in range(size):
            c0 = c1 = 0.0
            for q in range(size):
                c0 += A[0, q] * C[q, p]
                c1 += A[1, q] * C[q, p]
            m00 -= c0 * A[0, p]
            m01 -= c0 * A[1, p]
            m11 -= c1 * A[1, p]
        rest = m00 * m11 - m01 * m01
        if m00 > _LEAST_REDUNDANCY * s00 and rest > _LEAST_REDUNDANCY**2 * (s00 * s11 - s01 * s01):
            out[i] = (m11 * r0 * r0 - 2.0 * m01 * r0 * r1 + m00 * r1 * r1) / rest
        else:
            out[i] = 0.0


def innovations(component: Component, placed: Placed) -> Floats:
    """Normalised innovation squared (s,) of a member's shared landmarks, each against the map without it."""
    _, _, estimate, information = component.parts[component.at(placed.submap.number)]
    xi, J = np.empty(estimate.shape[0]), np.empty((estimate.shape[0], 8))
    invariant = placed.submap.invariant
    residual(invariant, estimate, np.array(placed.frame), np.array(placed.end), placed.points, xi, J)
    out = np.empty(len(placed.shared))
    tie_nis(information, xi, J, np.ascontiguousarray(placed.covariance), out)
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
    """Where a member's own estimate puts a landmark (2,), and its covariance (2, 2)."""
    submap = component.members[f]
    slot = submap.slot_of(landmark)
    placed = component.placed(submap.number, inverse)
    at = np.array(transform(placed.frame, float(submap.mean[slot]), float(submap.mean[slot + 1])))
    R = rotation(placed.frame[2])
    by_frame = np.array([[1.0, 0.0, placed.frame[1] - at[1]], [0.0, 1.0, at[0] - placed.frame[0]]])
    own = R @ additive_covariance(submap, [slot]) @ R.T
    return at, own + by_frame @ placed.frame_covariance @ by_frame.T
