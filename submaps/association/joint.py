"""Joint compatibility branch and bound: the largest set of pairs that all fit together.

Neira & Tardós, "Data association in stochastic mapping using the joint compatibility test", IEEE
Transactions on Robotics and Automation 17(6), 2001. Readings of one step err together, through the pose
that they share: each may be nearest to a wrong landmark, and only all of them together tell.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.association.candidates import Candidates, factorise, log_determinant
from submaps.association.result import NEW, Association, Gates, settled
from submaps.geometry.logarithm import log
from submaps.geometry.trig import EPSILON

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

MOST_NODES = 20_000


def joint(candidates: Candidates, gates: Gates, most_nodes: int = MOST_NODES) -> Association:
    """Find the hypothesis H with the most pairs; of those with as many, the likeliest.

    Pairs have to lie within the gate each, and together: D^2_H = v_H^T C_H^-1 v_H within that of d |H|
    degrees of freedom (eq. 11), for H and for each hypothesis on the way to it. Observations with few
    candidates come first. C_H is factorised row by row as H grows, so a further pair costs O(d^3 |H|^2).
    Among as many pairs the least D^2_H + ln(|C_H| / prod |R_i|) is taken (the paper: the least D^2_H);
    see ``Candidates.distance``. Neither it nor D^2_H falls as H grows, which bounds the search.

    After ``most_nodes`` pairs tried the best hypothesis so far is taken, and ``complete`` is false: its
    pairs fit together, but there may be a larger one.
    """
    d = candidates.readings.dimension
    chosen = np.full(candidates.observations, NEW, dtype=np.int64)
    within = candidates.squared <= gates.bound(d)
    counts = within.sum(axis=1)
    rows = np.argsort(counts, kind="stable")
    rows = rows[counts[rows] > 0]
    if rows.size == 0:
        return settled(candidates, gates, chosen)
    # Each row's landmarks, the likeliest first.
    order = np.argsort(np.where(within[rows], candidates.distance[rows], np.inf), axis=1, kind="stable")
    of_row = [order[k, : counts[i]] for k, i in enumerate(rows)]
    options = np.concatenate(of_row)
    landmarks, option = np.unique(options, return_inverse=True)
    v = candidates.innovation[np.repeat(rows, counts[rows]), options]
    bounds = np.array([0.0] + [gates.bound(d * p) for p in range(1, rows.size + 1)])
    found = np.full(rows.size, -1, dtype=np.int64)
    nodes, complete = _search(
        np.concatenate([[0], np.cumsum(counts[rows])]), option.ravel(), v, candidates.noise[rows],
        candidates.readings.blocks(landmarks), bounds, most_nodes, found,
    )  # fmt: skip
    paired = found >= 0
    chosen[rows[paired]] = options[found[paired]]
    return settled(candidates, gates, chosen, nodes=nodes, complete=complete)


@jit()
def _append(
    p: int, v: Floats, R: Floats, own: float, landmark: int, blocks: Floats, paired: Ints, bounds: Floats,
    L: Floats, w: Floats, squared: Floats, score: Floats,
) -> bool:  # fmt: skip
    """Add a pair to the ``p`` in L and w = L^-1 v_H, and D^2 and score at p + 1; whether all are compatible."""
    d = v.shape[0]
    squared[p + 1], score[p + 1] = squared[p], score[p]
    determinant = 0.0
    for r in range(d):
        row = p * d + r
        for c in range(row + 1):
            other, within = c // d, c % d
            whole = blocks[landmark, paired[other] if other < p else landmark, r, within]
            if other == p:
                whole += R[r, within]
            rest = whole
            for k in range(c):
                rest -= L[row, k] * L[c, k]
            if c < row:
                L[row, c] = rest / L[c, c]
            elif rest > 4.0 * EPSILON * whole and rest < math.inf:
                L[row, row] = math.sqrt(rest)
            else:
                return False
        whitened = v[r]
        for k in range(row):
            whitened -= L[row, k] * w[k]
        w[row] = whitened / L[row, row]
        squared[p + 1] += w[row] * w[row]
        determinant += 2.0 * log(L[row, row])
    # Rounding aside the pivots are no smaller than those of R.
    score[p + 1] += squared[p + 1] - squared[p] + max(determinant - own, 0.0)
    compatible: bool = squared[p + 1] <= bounds[p + 1]
    return compatible


@jit()
def _better(pairs: int, score: float, best_pairs: int, best_score: float) -> bool:
    return pairs > best_pairs or (pairs == best_pairs and score < best_score)


@jit()
def _own_determinants(R: Floats) -> Floats:
    """ln |R_i| (q,) of R (q, d, d)."""
    own, L = np.empty(R.shape[0]), np.empty(R.shape[1:])
    for i in range(R.shape[0]):
        L[:] = R[i]
        factorise(L)
        own[i] = log_determinant(L)
    return own


@jit(
    "Tuple((int64, boolean))(int64[::1], int64[::1], float64[:, ::1], float64[:, :, ::1], float64[:, :, :, ::1],"
    "float64[::1], int64, int64[::1])",
    unlocked=True,
)
def _search(
    first: Ints, option: Ints, v: Floats, R: Floats, blocks: Floats, bounds: Floats, most_nodes: int, best: Ints
) -> tuple[int, bool]:
    """Depth first over rows (q,): row i may have options first[i] .. first[i + 1], or none.

    ``option`` is the place in ``blocks`` of an option's landmark, v (options, d) its innovation. Writes
    each row's option in the best hypothesis, or -1; returns how many pairs were tried, and whether all
    that could be better were.
    """
    q, size = R.shape[0], R.shape[0] * R.shape[1]
    L, w, squared, score = np.zeros((size, size)), np.zeros(size), np.zeros(q + 1), np.zeros(q + 1)
    own, taken = _own_determinants(R), np.zeros(blocks.shape[0], dtype=np.bool_)
    chosen, paired, upcoming = np.full(q, -1), np.zeros(q, dtype=np.int64), first.copy()
    best_pairs, best_score = -1, math.inf
    depth = pairs = nodes = 0
    while True:
        if depth < q and upcoming[depth] <= first[depth + 1]:
            at = upcoming[depth]
            alone = at == first[depth + 1]
            if not _better(pairs + q - depth - alone, score[pairs], best_pairs, best_score):
                upcoming[depth] = first[depth + 1] + 1  # nor can what is left here be better
                continue
            upcoming[depth] += 1
            if not alone:
                if nodes == most_nodes:
                    if _better(pairs, score[pairs], best_pairs, best_score):
                        best[:] = chosen
                    return nodes, False
                nodes += 1
                j = option[at]
                if taken[j] or not _append(
                    pairs, v[at], R[depth], own[depth], j, blocks, paired, bounds, L, w, squared, score
                ):
                    continue
                taken[j] = True
                chosen[depth], paired[pairs] = at, j
                pairs += 1
            depth += 1
            upcoming[depth] = first[depth]
            continue
        if depth == q and _better(pairs, score[pairs], best_pairs, best_score):
            best_pairs, best_score = pairs, score[pairs]
            best[:] = chosen
        if depth == 0:
            return nodes, True
        depth -= 1
        if chosen[depth] >= 0:
            taken[option[chosen[depth]]] = False
            chosen[depth] = -1
            pairs -= 1
