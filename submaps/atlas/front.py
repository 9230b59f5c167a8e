"""What the last solution leaves to the sub-maps after it: the frontier of the atlas.

Between two solves a robot's active sub-map changes and others follow it. Each is conditioned on the
one before: the joint of its frame and the landmarks that both hold goes in, its own factor is
multiplied on, and what the next one needs comes out. Work is bounded by one sub-map, and nothing is
counted twice: the factor that the solve used for a sub-map still active then is taken out first.
Ties to sub-maps older than the neighbour wait for the next solve.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.atlas.factors import cholesky, factor, information, normal_equations, residual, rows_of
from submaps.atlas.placed import Placed, as_pose
from submaps.errors import NumericalError
from submaps.geometry.se2 import ORIGIN, Pose, compose, transform
from submaps.submap import Submap

Floats = NDArray[np.float64]
_ITERATIONS = 20
_CONVERGED = 1e-10


@dataclass(frozen=True)
class Front:
    """Information about a sub-map's frame and landmarks from everything but its own factor.

    ``information`` (3 + 2m, 3 + 2m) and ``vector`` (3 + 2m,) are of the increments of (``frame``,
    ``points``): cost d^T information d + 2 vector^T d. A ``fixed`` frame is the component's first.
    """

    frame: Pose
    landmarks: list[int]
    points: Floats
    information: Floats
    vector: Floats
    fixed: bool

    @classmethod
    def first(cls) -> Front:
        """That of a component's first sub-map: its frame is the origin, and nothing else is known."""
        return cls(ORIGIN, [], np.empty((0, 2)), np.zeros((3, 3)), np.zeros(3), True)

    @classmethod
    def of_start(cls, frame: Pose, covariance: Floats) -> Front:
        """That of a first sub-map whose frame is known by the (3, 3) covariance of its additive errors."""
        return cls(
            frame, [], np.empty((0, 2)), np.asarray(np.linalg.inv(covariance), dtype=np.float64), np.zeros(3), False
        )

    @classmethod
    def of_solution(cls, placed: Placed, fixed: bool) -> Front:
        """That of a sub-map which was active in a solve: the solve's joint less the factor it had then.

        A ``fixed`` frame is the root of its component.
        """
        H, g, _ = _equations(placed.submap, placed.shared, placed.frame, placed.end, placed.points)
        own, gradient = _eliminate(H, g, np.arange(3, 6))
        size = own.shape[0]
        kept = np.r_[0:3, 6 : size + 3]
        free = np.arange(3 if fixed else 0, size)
        information = np.zeros((size, size))
        inside = np.ix_(free, free)
        information[inside] = np.linalg.inv(placed.covariance[np.ix_(kept, kept)][inside]) - own[inside]
        return cls(placed.frame, placed.shared, placed.points, information, -gradient, fixed)


def _equations(
    submap: Submap, shared: list[int], frame: Pose, end: Pose, points: Floats
) -> tuple[Floats, Floats, float]:
    """A sub-map's Gauss-Newton block, gradient and cost over frame, end and shared landmarks."""
    estimate, information = factor(submap, rows_of(submap, shared))
    d = estimate.shape[0]
    xi, J, H, g = np.empty(d), np.empty((d, 8)), np.empty((d + 3, d + 3)), np.empty(d + 3)
    residual(submap.invariant, estimate, np.array(frame), np.array(end), points, xi, J)
    cost = normal_equations(information, xi, J, H, g)
    return np.tril(H) + np.tril(H, -1).T, g, cost


def _eliminate(H: Floats, g: Floats, gone: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """Schur complement: information and gradient of the rest after the entries ``gone`` are marginalised."""
    kept = np.setdiff1d(np.arange(H.shape[0]), gone)
    if gone.shape[0] == 0:
        return H, g
    weight = np.linalg.solve(H[np.ix_(gone, gone)], H[np.ix_(gone, kept)]).T
    reduced = H[np.ix_(kept, kept)] - weight @ H[np.ix_(gone, kept)]
    return 0.5 * (reduced + reduced.T), g[kept] - weight @ g[gone]


@dataclass(frozen=True)
class _Joint:
    """The posterior of one sub-map at the front: frame, end and ``landmarks``, with their covariance."""

    placed: Placed
    landmarks: list[int]
    points: Floats
    covariance: Floats


@jit()
def _step(L: Floats, g: Floats, first: int, values: Floats) -> float:
    """values <- values - (L L^T)^-1 g from entry ``first`` on; the largest change."""
    n = L.shape[0]
    x = g[first:].copy()
    for i in range(n):
        for k in range(i):
            x[i] -= L[i, k] * x[k]
        x[i] /= L[i, i]
    largest = 0.0
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= L[k, i] * x[k]
        x[i] /= L[i, i]
        values[first + i] -= x[i]
        largest = max(largest, abs(x[i]))
    return largest


@jit(
    "boolean(boolean, float64[::1], float64[:, ::1], int64[::1], float64[:, ::1], float64[::1], int64, float64[::1],"
    "float64[:, ::1], float64[:, ::1])"
)
def _settle(
    invariant: bool, estimate: Floats, own_information: Floats, place: NDArray[np.int64], information_: Floats,
    vector: Floats, first: int, values: Floats, H: Floats, covariance: Floats,
) -> bool:  # fmt: skip
    """Gauss-Newton over (frame, end, landmarks) in place, with H at the end and its inverse.

    ``place`` (s,) says which landmarks the factor speaks of; ``information_`` and ``vector`` are of the
    frame and the first landmarks. Entries before ``first`` are held. False where H is not positive
    definite.
    """
    n, d, m = values.shape[0], estimate.shape[0], vector.shape[0]
    start = values.copy()
    at = np.empty(d + 3, dtype=np.int64)  # of the factor's variables, and of the front's, in ``values``
    at[:6] = np.arange(6)
    for i in range(place.shape[0]):
        at[6 + 2 * i], at[7 + 2 * i] = 6 + 2 * place[i], 7 + 2 * place[i]
    seen, xi, J = np.empty((place.shape[0], 2)), np.empty(d), np.empty((d, 8))
    block, gradient = np.empty((d + 3, d + 3)), np.empty(d + 3)
    g = np.empty(n)
    A = np.empty((n - first, n - first))
    covariance[:] = 0.0
    for _ in range(_ITERATIONS):
        for i in range(place.shape[0]):
            seen[i, 0], seen[i, 1] = values[6 + 2 * place[i]], values[7 + 2 * place[i]]
        residual(invariant, estimate, values[:3], values[3:6], seen, xi, J)
        normal_equations(own_information, xi, J, block, gradient)
        H[:] = 0.0
        g[:] = 0.0
        for i in range(d + 3):
            g[at[i]] += gradient[i]
            for j in range(i + 1):
                H[at[i], at[j]] += block[i, j]
                if i != j:
                    H[at[j], at[i]] += block[i, j]
        for i in range(m):
            p = i if i < 3 else i + 3
            g[p] += vector[i]
            for j in range(m):
                q = j if j < 3 else j + 3
                H[p, q] += information_[i, j]
                g[p] += information_[i, j] * (values[q] - start[q])
        A[:] = H[first:, first:]
        if not cholesky(A):
            return False
        largest = _step(A, g, first, values)
        if largest < _CONVERGED:
            break
    A[:] = H[first:, first:]
    inverse = np.empty_like(A)
    good = information(A, inverse)
    covariance[first:, first:] = inverse
    return good


def condition(front: Front, submap: Submap, following: Submap | None = None) -> _Joint:
    """Gauss-Newton on the front's information and the sub-map's own factor.

    With ``following``, the landmarks that it shares with the sub-map stay in as well.
    """
    slots = submap.slots()
    landmarks = list(front.landmarks)
    if following is not None:
        known = set(landmarks)
        landmarks += [i for i in following.landmarks.tolist() if i in slots and i not in known]
    shared = [i for i in landmarks if i in slots]
    points = np.empty((len(landmarks), 2))
    points[: len(front.landmarks)] = front.points
    for i in range(len(front.landmarks), len(landmarks)):
        at = slots[landmarks[i]]
        points[i] = transform(front.frame, float(submap.mean[at]), float(submap.mean[at + 1]))
    values = np.concatenate([front.frame, compose(front.frame, submap.pose), points.ravel()])
    place = np.array([landmarks.index(i) for i in shared], dtype=np.int64)
    estimate, own_information = factor(submap, rows_of(submap, shared))
    H, covariance = np.empty((2, values.shape[0], values.shape[0]))
    if not _settle(
        submap.invariant, estimate, own_information, place, np.ascontiguousarray(front.information),
        np.ascontiguousarray(front.vector), 3 if front.fixed else 0, values, H, covariance,
    ):  # fmt: skip
        raise NumericalError(f"submap {submap.number}: what is known of it does not determine its place")
    points = values[6:].reshape(-1, 2)
    own = np.concatenate([np.arange(6), (6 + 2 * place[:, np.newaxis] + np.arange(2)).ravel()])
    placed = Placed(
        submap, as_pose(values[:3]), as_pose(values[3:6]), shared, np.ascontiguousarray(points[place]),
        covariance[own[:, np.newaxis], own],
    )  # fmt: skip
    return _Joint(placed, landmarks, points, covariance)


def advance(front: Front, submap: Submap, following: Submap) -> Front:
    """The front of ``following``, whose frame is the end of the closed ``submap``."""
    joint = condition(front, submap, following)
    after = set(following.landmarks.tolist())
    keep = [i for i, number in enumerate(joint.landmarks) if number in after]
    kept = np.array([3, 4, 5, *(6 + 2 * i + a for i in keep for a in (0, 1))])
    known = np.empty((kept.shape[0],) * 2)
    if not information(np.ascontiguousarray(joint.covariance[kept[:, np.newaxis], kept]), known):
        raise NumericalError(f"submap {submap.number}: what is known of it does not determine its end")
    landmarks = [joint.landmarks[i] for i in keep]
    # Converged: no gradient is left.
    return Front(joint.placed.end, landmarks, joint.points[keep], known, np.zeros(kept.shape[0]), False)
