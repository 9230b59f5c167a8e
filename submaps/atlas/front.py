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
from submaps.atlas.placed import Placed, as_pose, rotation
from submaps.errors import NumericalError
from submaps.geometry.se2 import ORIGIN, Pose, between, compose
from submaps.submap import Submap

Floats = NDArray[np.float64]
_ITERATIONS = 20
_CONVERGED = 1e-10


@dataclass(frozen=True)
class Front:
    """Information about a sub-map's frame and landmarks from everything but its own factor.

    ``points`` (m, 2) are in the sub-map's frame; ``information`` (3 + 2m, 3 + 2m) and ``vector``
    (3 + 2m,) are of the increments of (``frame``, ``points``): cost d^T information d + 2 vector^T d.
    A ``fixed`` frame is the component's first.
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
        known = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
        return cls(frame, [], np.empty((0, 2)), known, np.zeros(3), False)

    @classmethod
    def of_solution(cls, placed: Placed, fixed: bool) -> Front:
        """That of a sub-map which was active in a solve: the solve's joint less the factor it had then.

        A ``fixed`` frame is the root of its component.
        """
        points = _within(placed.frame, placed.points)
        kept = np.r_[0:3, 6 : placed.covariance.shape[0]]
        to_own = _to_own(placed.frame, points)
        covariance = to_own @ placed.covariance[np.ix_(kept, kept)] @ to_own.T
        first = 3 if fixed else 0
        whole = np.zeros_like(covariance)
        whole[first:, first:] = _inverse(placed.submap, np.ascontiguousarray(covariance[first:, first:]))
        own, gradient = _own_information(placed.submap, placed.shared, between(placed.frame, placed.end), points)
        whole[3:, 3:] -= own
        return cls(placed.frame, placed.shared, points, whole, np.concatenate([np.zeros(3), -gradient]), fixed)


def _within(frame: Pose, points: Floats) -> Floats:
    """Points (m, 2) given beside a frame, in that frame."""
    return np.ascontiguousarray((points - frame[:2]) @ rotation(frame[2]))


def _to_own(frame: Pose, points: Floats) -> Floats:
    """d(frame, points in it) / d(frame, points beside it), (3 + 2m, 3 + 2m)."""
    R = rotation(frame[2])
    D = np.eye(3 + points.size)
    for i, (x, y) in enumerate(points):
        rows = slice(3 + 2 * i, 5 + 2 * i)
        D[rows, rows], D[rows, :2], D[rows, 2] = R.T, -R.T, (y, -x)
    return D


def _inverse(submap: Submap, covariance: Floats) -> Floats:
    out = np.empty_like(covariance)
    if not information(covariance, out):
        raise NumericalError(f"submap {submap.number}: the covariance of what is known of it is not positive definite")
    return out


def _own_information(submap: Submap, shared: list[int], end: Pose, points: Floats) -> tuple[Floats, Floats]:
    """What a sub-map's factor says of its shared landmarks in its own frame, the end marginalised."""
    estimate, own = factor(submap, rows_of(submap, shared))
    d = estimate.shape[0]
    xi, J, H, g = np.empty(d), np.empty((d, 8)), np.empty((d + 3, d + 3)), np.empty(d + 3)
    residual(submap.invariant, estimate, np.zeros(3), np.array(end), points, xi, J)
    normal_equations(own, xi, J, H, g)
    H = np.tril(H) + np.tril(H, -1).T
    weight = np.linalg.solve(H[3:6, 3:6], H[3:6, 6:]).T
    reduced = H[6:, 6:] - weight @ H[3:6, 6:]
    return 0.5 * (reduced + reduced.T), g[6:] - weight @ g[3:6]


@dataclass(frozen=True)
class Joint:
    """The posterior of one sub-map at the front: its frame, and its end and ``landmarks`` in that frame."""

    submap: Submap
    frame: Pose
    end: Pose
    landmarks: list[int]
    shared: list[int]
    points: Floats
    covariance: Floats

    def placed(self) -> Placed:
        """The same beside the frame, as queries want it."""
        R, points = rotation(self.frame[2]), self.points
        D = np.eye(self.covariance.shape[0])
        for at, (x, y) in [(3, self.end[:2]), *((6 + 2 * i, point) for i, point in enumerate(points))]:
            D[at : at + 2, at : at + 2], D[at : at + 2, :2] = R, np.eye(2)
            D[at : at + 2, 2] = R @ (-y, x)
        D[5, 2] = 1.0
        place = np.array([self.landmarks.index(i) for i in self.shared], dtype=np.int64)
        own = np.concatenate([np.arange(6), (6 + 2 * place[:, np.newaxis] + np.arange(2)).ravel()])
        D = D[own]
        beside = points[place].reshape(-1, 2) @ R.T + self.frame[:2]
        covariance = D @ self.covariance @ D.T
        end = compose(self.frame, self.end)
        return Placed(self.submap, self.frame, end, self.shared, beside, 0.5 * (covariance + covariance.T))


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
    """Gauss-Newton over (frame, end, landmarks) in place, and the inverse of H at the end.

    End and landmarks are in the frame, so that the factor does not speak of where that lies: far
    away, and little known, it would drown what is known of it. ``place`` (s,) says which landmarks
    the factor speaks of; ``information_`` and ``vector`` are of the frame and the first landmarks.
    Entries before ``first`` are held. False where H is not positive definite.
    """
    n, d, m = values.shape[0], estimate.shape[0], vector.shape[0]
    start, origin = values.copy(), np.zeros(3)
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
        residual(invariant, estimate, origin, values[3:6], seen, xi, J)
        normal_equations(own_information, xi, J, block, gradient)
        H[:] = 0.0
        g[:] = 0.0
        for i in range(3, d + 3):
            g[at[i]] += gradient[i]
            for j in range(3, i + 1):
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


def condition(front: Front, submap: Submap, following: Submap | None = None) -> Joint:
    """Gauss-Newton on the front's information and the sub-map's own factor.

    With ``following``, the landmarks that it shares with the sub-map stay in as well. Raises
    ``NumericalError`` where what is known does not determine the sub-map's place.
    """
    slots = submap.slots()
    landmarks = list(front.landmarks)
    if following is not None:
        known = set(landmarks)
        landmarks += [i for i in following.landmarks.tolist() if i in slots and i not in known]
    shared = [i for i in landmarks if i in slots]
    new = [slots[i] + k for i in landmarks[len(front.landmarks) :] for k in (0, 1)]
    values = np.concatenate([front.frame, submap.pose, front.points.ravel(), submap.mean[new]])
    place = np.array([landmarks.index(i) for i in shared], dtype=np.int64)
    estimate, own_information = factor(submap, rows_of(submap, shared))
    H, covariance = np.empty((2, values.shape[0], values.shape[0]))
    if not _settle(
        submap.invariant, estimate, own_information, place, np.ascontiguousarray(front.information),
        np.ascontiguousarray(front.vector), 3 if front.fixed else 0, values, H, covariance,
    ):  # fmt: skip
        raise NumericalError(f"submap {submap.number}: what is known of it does not determine its place")
    frame, end = as_pose(values[:3]), as_pose(values[3:6])
    return Joint(submap, frame, end, landmarks, shared, values[6:].reshape(-1, 2), covariance)


def advance(front: Front, submap: Submap, following: Submap) -> Front:
    """The front of ``following``, whose frame is the end of the closed ``submap``."""
    joint = condition(front, submap, following)
    after = set(following.landmarks.tolist())
    keep = [i for i, number in enumerate(joint.landmarks) if number in after]
    points = _within(joint.end, joint.points[keep].reshape(-1, 2))
    R, T = rotation(joint.frame[2]), rotation(joint.end[2]).T
    D = np.zeros((3 + points.size, joint.covariance.shape[0]))  # d(new frame, points in it) / d(frame, end, points)
    x, y = joint.end[:2]
    D[:3, :3], D[:2, 2], D[:2, 3:5], D[2, 5] = np.eye(3), R @ (-y, x), R, 1.0
    for i, (k, (u, v)) in enumerate(zip(keep, points, strict=True)):
        rows = slice(3 + 2 * i, 5 + 2 * i)
        D[rows, 6 + 2 * k : 8 + 2 * k], D[rows, 3:5], D[rows, 5] = T, -T, (v, -u)
    known = _inverse(submap, np.ascontiguousarray(D @ joint.covariance @ D.T))
    landmarks = [joint.landmarks[i] for i in keep]
    # Converged: no gradient is left.
    return Front(compose(joint.frame, joint.end), landmarks, points, known, np.zeros(known.shape[0]), False)
