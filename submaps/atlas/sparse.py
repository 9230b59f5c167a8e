"""Sparse normal equations: their pattern, their factorisation, and the inverse on that pattern.

Variables are poses, then points, of a few entries each; a factor couples all of its variables with one
another.
QDLDL factorises (LDL^T after an AMD ordering); Takahashi's recurrence gives the entries of the
inverse that lie on the factor's pattern (Takahashi, Fagan, Chin 1973; Erisman, Tinney 1975).
"""

from __future__ import annotations

import numpy as np
import qdldl
from numpy.typing import NDArray
from scipy.sparse import csc_array, csc_matrix

from submaps._jit import jit
from submaps.errors import NumericalError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@jit("Tuple((int64[::1], int64[::1]))(int64[::1], int64[::1], int64)", unlocked=True)
def _block_pattern(offsets: Ints, members: Ints, count: int) -> tuple[Ints, Ints]:
    """Upper block pattern: for each variable, the variables up to it that share a factor with it."""
    factors_of = np.zeros(count + 1, dtype=np.int64)
    for v in members:
        factors_of[v + 1] += 1
    for v in range(count):
        factors_of[v + 1] += factors_of[v]
    listed = np.empty(members.shape[0], dtype=np.int64)
    fill = factors_of[:-1].copy()
    for f in range(offsets.shape[0] - 1):
        for m in range(offsets[f], offsets[f + 1]):
            listed[fill[members[m]]] = f
            fill[members[m]] += 1
    seen = np.full(count, -1, dtype=np.int64)
    begins = np.zeros(count + 1, dtype=np.int64)
    rows = np.empty(max(16, 4 * count), dtype=np.int64)
    size = 0
    for v in range(count):
        first = size
        if size + v + 1 > rows.shape[0]:
            rows = np.concatenate((rows, np.empty(rows.shape[0] + v + 1, dtype=np.int64)))
        seen[v] = v
        rows[size] = v
        size += 1
        for k in range(factors_of[v], factors_of[v + 1]):
            f = listed[k]
            for m in range(offsets[f], offsets[f + 1]):
                w = members[m]
                if w < v and seen[w] != v:
                    seen[w] = v
                    rows[size] = w
                    size += 1
        rows[first:size].sort()
        begins[v + 1] = size
    return begins, rows[:size].copy()


@jit("Tuple((int32[::1], int32[::1], int64[::1]))(int64[::1], int64[::1], int64[::1])", unlocked=True)
def _entries(begins: Ints, rows: Ints, start: Ints) -> tuple[NDArray[np.int32], NDArray[np.int32], Ints]:
    """Column pointers and row indices of the upper triangle; each block's first row within its columns."""
    count = begins.shape[0] - 1
    pointers = np.zeros(start[count] + 1, dtype=np.int32)
    within = np.empty(rows.shape[0], dtype=np.int64)
    for v in range(count):
        above = 0
        for k in range(begins[v], begins[v + 1]):
            within[k] = above
            above += start[rows[k] + 1] - start[rows[k]]
        width = start[v + 1] - start[v]
        for c in range(width):
            pointers[start[v] + c + 1] = above - width + c + 1
    for c in range(start[count]):
        pointers[c + 1] += pointers[c]
    indices = np.empty(pointers[-1], dtype=np.int32)
    for v in range(count):
        for c in range(start[v + 1] - start[v]):
            k = pointers[start[v] + c]
            for b in range(begins[v], begins[v + 1]):
                w = rows[b]
                top = start[w + 1] if w < v else start[v] + c + 1
                for r in range(start[w], top):
                    indices[k] = r
                    k += 1
    return pointers, indices, within


@jit(
    "void(int64[::1], float64[:, ::1], float64[::1], int64[::1], int64[::1], int64[::1], int64[::1], int32[::1],"
    "float64[::1], float64[::1])"
)
def scatter(
    variables: Ints, H: Floats, g: Floats, begins: Ints, rows: Ints, within: Ints, start: Ints,
    pointers: NDArray[np.int32], data: Floats, gradient: Floats,
) -> None:  # fmt: skip
    """Add a factor's block (its lower triangle, in the order of ``variables``) to the whole.

    A negative variable is fixed, a pose like the first; its rows and columns are passed over.
    """
    fixed = start[1] - start[0]
    at_a = 0
    for a in range(variables.shape[0]):
        va = variables[a]
        wa = fixed if va < 0 else start[va + 1] - start[va]
        if va >= 0:
            for r in range(wa):
                gradient[start[va] + r] += g[at_a + r]
            at_b = 0
            for b in range(a + 1):
                vb = variables[b]
                wb = fixed if vb < 0 else start[vb + 1] - start[vb]
                if vb >= 0:
                    top, left = (vb, va) if vb <= va else (va, vb)
                    k = begins[left] + np.searchsorted(rows[begins[left] : begins[left + 1]], top)
                    for r in range(wa):
                        for q in range(wb if a != b else r + 1):
                            i, j = (q, r) if vb <= va else (r, q)  # row within top, column within left
                            data[pointers[start[left] + j] + within[k] + i] += H[at_a + r, at_b + q]
                at_b += wb
        at_a += wa


@jit("float64[::1](int32[::1], int32[::1], float64[::1], float64[::1])", unlocked=True)
def _takahashi(pointers: NDArray[np.int32], indices: NDArray[np.int32], L: Floats, D: Floats) -> Floats:
    """Z = (L D L^T)^-1 on the pattern of L: off-diagonals in L's order, then the diagonal.

    Z_ij = delta_ij / D_j - sum_k L_kj Z_ik over k in column j, from the last column to the first.
    """
    n = D.shape[0]
    count = L.shape[0]
    Z = np.zeros(count + n)
    place = np.full(n, -1, dtype=np.int64)
    total = np.empty(n)
    for j in range(n - 1, -1, -1):
        begin, end = pointers[j], pointers[j + 1]
        for k in range(begin, end):
            place[indices[k]] = k - begin
            total[k - begin] = 0.0
        for k in range(begin, end):
            row, lkj = indices[k], L[k]
            total[k - begin] += lkj * Z[count + row]
            for m in range(pointers[row], pointers[row + 1]):
                at = place[indices[m]]
                if at >= 0:
                    total[at] += lkj * Z[m]
                    total[k - begin] += L[begin + at] * Z[m]
        diagonal = 1.0 / D[j]
        for k in range(begin, end):
            Z[k] = -total[k - begin]
            diagonal -= L[k] * Z[k]
            place[indices[k]] = -1
        Z[count + j] = diagonal
    return Z


@jit("float64[:, ::1](int64[::1], int32[::1], int32[::1], float64[::1])")
def _gather(at: Ints, pointers: NDArray[np.int32], indices: NDArray[np.int32], Z: Floats) -> Floats:
    """(d, d) block of the inverse for the permuted entries ``at``; they must share a factor."""
    d = at.shape[0]
    count = indices.shape[0]
    out = np.empty((d, d))
    for a in range(d):
        out[a, a] = Z[count + at[a]]
        for b in range(a):
            low, high = min(at[a], at[b]), max(at[a], at[b])
            column = indices[pointers[low] : pointers[low + 1]]
            k = np.searchsorted(column, high)
            value = Z[pointers[low] + k] if k < column.shape[0] and column[k] == high else np.nan
            out[a, b] = value
            out[b, a] = value
    return out


class Pattern:
    """Where a set of factors puts its entries in the upper triangle of the normal equations."""

    def __init__(self, widths: Ints, offsets: Ints, variables: Ints) -> None:
        """Factor f has the ``variables`` from ``offsets[f]`` to ``offsets[f + 1]``, negative ones fixed."""
        self.start = np.concatenate([[0], np.cumsum(widths)]).astype(np.int64)
        free = variables >= 0
        kept = np.concatenate([[0], np.cumsum(free)]).astype(np.int64)[offsets]
        self.begins, self.rows = _block_pattern(kept, variables[free], widths.shape[0])
        self.pointers, self.indices, self.within = _entries(self.begins, self.rows, self.start)
        self.size = int(self.start[-1])
        self.diagonal = self.pointers[1:] - 1

    def add(self, variables: Ints, H: Floats, g: Floats, data: Floats, gradient: Floats) -> None:
        """Add one factor's block and gradient."""
        scatter(variables, H, g, self.begins, self.rows, self.within, self.start, self.pointers, data, gradient)

    def matrix(self, data: Floats) -> csc_matrix:
        """The upper triangle as SciPy holds it."""
        return csc_matrix((data, self.indices, self.pointers), shape=(self.size, self.size))


class Factorisation:
    """LDL^T of positive definite normal equations; every pivot is checked."""

    def __init__(self, pattern: Pattern, data: Floats) -> None:
        self._pattern = pattern
        self._solver = qdldl.Solver(pattern.matrix(data), upper=True)
        self._check()

    def update(self, data: Floats) -> None:
        """Factorise again on the same pattern."""
        self._solver.update(self._pattern.matrix(data), upper=True)
        self._check()

    def _check(self) -> None:
        self._L, self._D, self._order = self._solver.factors()
        if not (np.all(np.isfinite(self._D)) and np.all(self._D > 0.0)):
            bad = int(np.flatnonzero(~(self._D > 0.0))[0]) if np.any(~(self._D > 0.0)) else -1
            raise NumericalError(f"pivot {bad} of the joined problem is not positive")

    def solve(self, right: Floats) -> Floats:
        """x with A x = right."""
        return np.asarray(self._solver.solve(right))

    def inverse_subset(self) -> InverseSubset:
        """The inverse on the factor's pattern."""
        return InverseSubset(self._pattern.start, csc_array(self._L), self._D, np.asarray(self._order))


class InverseSubset:
    """Joint covariances of any variables that share a factor."""

    def __init__(self, start: Ints, L: csc_array, D: Floats, order: NDArray[np.int64]) -> None:
        self._start = start
        self._pointers = L.indptr.astype(np.int32)
        self._indices = L.indices.astype(np.int32)
        self._Z = _takahashi(self._pointers, self._indices, L.data, D)
        self._place = np.empty(order.shape[0], dtype=np.int64)
        self._place[order] = np.arange(order.shape[0])

    def joint(self, variables: Ints) -> Floats:
        """(d, d) covariance of the variables' entries in the order given."""
        entries = np.concatenate([np.arange(self._start[v], self._start[v + 1]) for v in variables])
        return _gather(self._place[entries], self._pointers, self._indices, self._Z)
