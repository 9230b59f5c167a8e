"""Every pair of an observation and a landmark, measured: innovation, its covariance, its distances.

Everything is arrays over m observations of n landmarks, in readings of any dimension d and of points of
any dimension: a state enters only through the readings that it predicts and their Jacobians. What is
computed here decides what a map becomes, so it is compiled loops in a fixed order: the same bits on
every processor of one architecture.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.geometry.logarithm import log
from submaps.geometry.trig import EPSILON, wrap

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Readings:
    """What the landmarks of a state should read, before anything is seen of them.

    ``h`` (n, d) readings; ``H`` (n, d, k) their Jacobians by the entries ``entries`` (n, k) of the state's
    error, whose covariance is the leading block of ``P`` (N, N); ``angular`` (d,) is not 0 where a channel
    is an angle (rad). A landmark's reading depends on few entries, the pose's and its own, so k is small.
    """

    h: Floats
    H: Floats
    entries: Ints
    P: Floats
    angular: NDArray[np.uint8]

    @property
    def dimension(self) -> int:
        """Numbers in a reading."""
        return int(self.h.shape[1])

    def blocks(self, landmarks: Ints) -> Floats:
        """H_j P H_k^T (q, q, d, d) of some landmarks: what their readings share through the state."""
        out = np.empty((landmarks.shape[0], landmarks.shape[0], self.dimension, self.dimension))
        _blocks(self.H, self.entries, self.P, np.ascontiguousarray(landmarks), out)
        return out


@dataclass(frozen=True)
class Candidates:
    """m observations against n landmarks.

    ``innovation`` v = z - h (m, n, d), angles wrapped; ``covariance`` S = H P H^T + R (m, n, d, d);
    ``squared`` d^2 = v^T S^-1 v (m, n), the squared Mahalanobis distance; ``distance`` (m, n) is
    d^2 + ln(|S| / |R|). Where S is not positive definite both are infinite. ``noise`` R (m, d, d).

    The squared distance alone has a chi-square law, so gates are of it. It does not tell which of two
    landmarks within their gates is the likelier: a landmark of which little is known has a large S and
    is near to everything. ``distance`` is -2 ln of the likelihood N(v; 0, S) relative to that of a
    perfect prediction, N(0; 0, R): it has no unit and is never negative, so it can be added up over
    observations with noise of their own, and a sum of it only grows.
    """

    readings: Readings
    noise: Floats
    innovation: Floats
    covariance: Floats
    squared: Floats
    distance: Floats

    @property
    def observations(self) -> int:
        """Number of observations."""
        return int(self.squared.shape[0])

    @property
    def landmarks(self) -> int:
        """Number of landmarks."""
        return int(self.squared.shape[1])

    def joint(self, observations: Ints, landmarks: Ints) -> tuple[Floats, Floats]:
        """Innovation (q d,) of q pairs taken together, and its covariance H P H^T + R (q d, q d).

        The pairs correlate: each landmark is seen from the same uncertain pose.
        """
        q, d = observations.shape[0], self.readings.dimension
        blocks = self.readings.blocks(landmarks)
        blocks[np.arange(q), np.arange(q)] += self.noise[observations]
        return self.innovation[observations, landmarks].ravel(), blocks.transpose(0, 2, 1, 3).reshape(q * d, q * d)


def candidates(readings: Readings, z: Floats, noise: Floats) -> Candidates:
    """Measure observations ``z`` (m, d), with noise R (m, d, d) or (1, d, d) for all, against every landmark."""
    (m, d), n = z.shape, readings.h.shape[0]
    R = np.ascontiguousarray(noise if noise.shape[0] == m else np.repeat(noise, m, axis=0))
    v, S = np.empty((m, n, d)), np.empty((m, n, d, d))
    squared, distance = np.empty((m, n)), np.empty((m, n))
    _measure(
        readings.h, readings.H, readings.entries, readings.P, readings.angular,
        np.ascontiguousarray(z), R, v, S, squared, distance,
    )  # fmt: skip
    return Candidates(readings, R, v, S, squared, distance)


@jit()
def _block(H: Floats, entries: Ints, P: Floats, j: int, k: int, out: Floats) -> None:
    """``out`` (d, d) <- H_j P H_k^T."""
    d, count = H.shape[1], H.shape[2]
    out[:] = 0.0
    for a in range(count):
        row = P[entries[j, a]]
        for c in range(d):
            along = 0.0
            for b in range(count):
                along += row[entries[k, b]] * H[k, c, b]
            for r in range(d):
                out[r, c] += H[j, r, a] * along


@jit("void(float64[:, :, ::1], int64[:, ::1], float64[:, ::1], int64[::1], float64[:, :, :, ::1])")
def _blocks(H: Floats, entries: Ints, P: Floats, landmarks: Ints, out: Floats) -> None:
    for a in range(landmarks.shape[0]):
        for b in range(a + 1):
            _block(H, entries, P, landmarks[a], landmarks[b], out[a, b])
            if b < a:
                for r in range(out.shape[2]):
                    for c in range(out.shape[3]):
                        out[b, a, c, r] = out[a, b, r, c]


@jit("boolean(float64[:, ::1])")
def factorise(A: Floats) -> bool:
    """A <- L with A = L L^T (d, d), its upper part left alone; whether A was positive definite."""
    for i in range(A.shape[0]):
        whole = A[i, i]
        for j in range(i + 1):
            rest = A[i, j]
            for k in range(j):
                rest -= A[i, k] * A[j, k]
            if j < i:
                A[i, j] = rest / A[j, j]
            elif rest > 4.0 * EPSILON * whole and rest < math.inf:
                A[i, i] = math.sqrt(rest)
            else:
                return False
    return True


@jit("float64(float64[:, ::1])")
def log_determinant(L: Floats) -> float:
    """ln |L L^T|."""
    total = 0.0
    for i in range(L.shape[0]):
        total += 2.0 * log(L[i, i])
    return total


@jit(
    "void(float64[:, ::1], float64[:, :, ::1], int64[:, ::1], float64[:, ::1], uint8[::1], float64[:, ::1],"
    "float64[:, :, ::1], float64[:, :, ::1], float64[:, :, :, ::1], float64[:, ::1], float64[:, ::1])"
)
def _measure(
    h: Floats, H: Floats, entries: Ints, P: Floats, angular: NDArray[np.uint8], z: Floats, R: Floats,
    v: Floats, S: Floats, squared: Floats, distance: Floats,
) -> None:  # fmt: skip
    m, n, d = v.shape
    prior, L, w = np.empty((d, d)), np.empty((d, d)), np.empty(d)
    own = np.empty(m)
    for i in range(m):
        L[:] = R[i]
        own[i] = log_determinant(L) if factorise(L) else math.nan
    for j in range(n):
        _block(H, entries, P, j, j, prior)
        for i in range(m):
            for r in range(d):
                v[i, j, r] = z[i, r] - h[j, r]
                if angular[r] != 0:
                    v[i, j, r] = wrap(v[i, j, r])
                for c in range(d):
                    S[i, j, r, c] = prior[r, c] + R[i, r, c]
                    L[r, c] = S[i, j, r, c]
            squared[i, j] = distance[i, j] = math.inf
            if not factorise(L):
                continue
            total = 0.0
            for r in range(d):
                w[r] = v[i, j, r]
                for c in range(r):
                    w[r] -= L[r, c] * w[c]
                w[r] /= L[r, r]
                total += w[r] * w[r]
            if total < math.inf:
                squared[i, j] = total
                distance[i, j] = total + log_determinant(L) - own[i]
