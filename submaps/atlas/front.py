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
from submaps.atlas.carrying import into, onward, outward
from submaps.atlas.cholesky import cholesky, information
from submaps.atlas.coordinates import retract, retract_one
from submaps.atlas.factors import factor, normal_equations, residual, rows_of
from submaps.atlas.placed import Placed
from submaps.errors import NumericalError
from submaps.geometry.space import Key, Pose, Space
from submaps.submap import Submap

Floats = NDArray[np.float64]
_ITERATIONS = 20
_CONVERGED = 1e-10


@dataclass(frozen=True)
class Front:
    """Information about a sub-map's frame and landmarks from everything but its own factor.

    ``points`` (m, dim) are in the sub-map's frame; ``information`` (pose + dim m, pose + dim m) and
    ``vector`` (pose + dim m,) are of the increments d of (``frame``, ``points``): cost d^T information d +
    2 vector^T d, a rotation's increment its rotation vector. A ``fixed`` frame is the component's first.
    """

    frame: Pose
    landmarks: list[int]
    points: Floats
    information: Floats
    vector: Floats
    fixed: bool

    @classmethod
    def first(cls, space: Space) -> Front:
        """That of a component's first sub-map: its frame is the origin, and nothing else is known."""
        pose = space.pose
        return cls(space.origin, [], np.empty((0, space.dim)), np.zeros((pose, pose)), np.zeros(pose), True)

    @classmethod
    def of_start(cls, space: Space, frame: Pose, covariance: Floats) -> Front:
        """That of a first sub-map whose frame is known by the (pose, pose) covariance of its additive errors."""
        known = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
        return cls(frame, [], np.empty((0, space.dim)), known, np.zeros(space.pose), False)

    @classmethod
    def of_solution(cls, placed: Placed, fixed: bool) -> Front:
        """That of a sub-map which was active in a solve: the solve's joint less the factor it had then.

        A ``fixed`` frame is the root of its component.
        """
        space = placed.submap.space
        pose = space.pose
        kept = np.r_[0:pose, 2 * pose : placed.covariance.shape[0]]
        points, to_own = np.empty_like(placed.points), np.zeros((kept.shape[0], kept.shape[0]))
        into(space.key, np.array(placed.frame), placed.points, points, to_own)
        covariance = to_own @ placed.covariance[np.ix_(kept, kept)] @ to_own.T
        first = pose if fixed else 0
        whole = np.zeros_like(covariance)
        whole[first:, first:] = _inverse(placed.submap, np.ascontiguousarray(covariance[first:, first:]))
        end = space.between(placed.frame, placed.end)
        own, gradient = _own_information(placed.submap, placed.shared, end, points)
        whole[pose:, pose:] -= own
        return cls(placed.frame, placed.shared, points, whole, np.concatenate([np.zeros(pose), -gradient]), fixed)


def _inverse(submap: Submap, covariance: Floats) -> Floats:
    out = np.empty_like(covariance)
    if not information(covariance, out):
        raise NumericalError(f"submap {submap.number}: the covariance of what is known of it is not positive definite")
    return out


def _own_information(submap: Submap, shared: list[int], end: Pose, points: Floats) -> tuple[Floats, Floats]:
    """What a sub-map's factor says of its shared landmarks in its own frame, the end marginalised."""
    space, (estimate, own) = submap.space, factor(submap, rows_of(submap, shared))
    d, pose = estimate.shape[0], space.pose
    xi, J, H, g = np.empty(d), np.empty((d, 2 * pose + space.dim)), np.empty((d + pose, d + pose)), np.empty(d + pose)
    residual(space.key, submap.invariant, estimate, np.zeros(pose), np.array(end), points, xi, J)
    normal_equations(space.key, own, xi, J, H, g)
    H = np.tril(H) + np.tril(H, -1).T
    ends, rest = slice(pose, 2 * pose), slice(2 * pose, None)
    weight = np.linalg.solve(H[ends, ends], H[ends, rest]).T
    reduced = H[rest, rest] - weight @ H[ends, rest]
    return 0.5 * (reduced + reduced.T), g[rest] - weight @ g[ends]


@dataclass(frozen=True)
class Joint:
    """The posterior of one sub-map at the front: its frame, and its end and ``landmarks`` in that frame.

    ``information`` is the inverse of ``covariance``, but where the frame is fixed.
    """

    submap: Submap
    frame: Pose
    end: Pose
    landmarks: list[int]
    shared: list[int]
    points: Floats
    covariance: Floats
    information: Floats

    def placed(self) -> Placed:
        """The same beside the frame, as queries want it."""
        space, covariance = self.submap.space, self.covariance
        place = np.array([self.landmarks.index(i) for i in self.shared], dtype=np.int64)
        beside = np.empty((place.shape[0], space.dim))
        D = np.zeros((2 * space.pose + beside.size, covariance.shape[0]))
        outward(space.key, np.array(self.frame), np.array(self.end), self.points, place, beside, D)
        covariance, end = D @ covariance @ D.T, space.compose(self.frame, self.end)
        return Placed(self.submap, self.frame, end, self.shared, beside, 0.5 * (covariance + covariance.T))


@jit()
def _step(space: Key, L: Floats, g: Floats, first: int, values: Floats) -> float:
    """Move ``values`` by -(L L^T)^-1 g from entry ``first`` on; the largest change."""
    n, pose = L.shape[0], 3 * len(space) - 3
    x, end = g[first:].copy(), np.zeros(pose)
    for i in range(n):
        for k in range(i):
            x[i] -= L[i, k] * x[k]
        x[i] /= L[i, i]
    largest = 0.0
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= L[k, i] * x[k]
        x[i] /= L[i, i]
        largest = max(largest, abs(x[i]))
        if pose <= first + i < 2 * pose:
            end[first + i - pose] = -x[i]
        else:
            values[first + i] -= x[i]
    retract_one(space, values[pose : 2 * pose], end)
    return largest


_SETTLE = (
    "boolean(UniTuple(int64, {}), boolean, float64[::1], float64[:, ::1], int64[::1], float64[:, ::1], float64[::1],"
    "int64, float64[::1], float64[:, ::1], float64[:, ::1])"
)


@jit(_SETTLE.format(2), _SETTLE.format(3))
def _settle(
    space: Key, invariant: bool, estimate: Floats, own_information: Floats, place: NDArray[np.int64],
    information_: Floats, vector: Floats, first: int, values: Floats, H: Floats, covariance: Floats,
) -> bool:  # fmt: skip
    """Gauss-Newton over (the frame's increment, end, landmarks) in place, and the inverse of H at the end.

    End and landmarks are in the frame, so that the factor does not speak of where that lies: far
    away, and little known, it would drown what is known of it. ``place`` (s,) says which landmarks
    the factor speaks of; ``information_`` and ``vector`` are of the frame and the first landmarks.
    Entries before ``first`` are held. False where H is not positive definite.
    """
    n, d, m, dim = values.shape[0], estimate.shape[0], vector.shape[0], len(space)
    pose = 3 * dim - 3
    start, origin = values.copy(), np.zeros(pose)
    at = np.empty(d + pose, dtype=np.int64)  # of the factor's variables, and of the front's, in ``values``
    at[: 2 * pose] = np.arange(2 * pose)
    for i in range(place.shape[0]):
        for a in range(dim):
            at[2 * pose + dim * i + a] = 2 * pose + dim * place[i] + a
    seen, xi, J = np.empty((place.shape[0], dim)), np.empty(d), np.empty((d, 2 * pose + dim))
    block, gradient = np.empty((d + pose, d + pose)), np.empty(d + pose)
    g = np.empty(n)
    A = np.empty((n - first, n - first))
    covariance[:] = 0.0
    for _ in range(_ITERATIONS):
        for i in range(place.shape[0]):
            for a in range(dim):
                seen[i, a] = values[2 * pose + dim * place[i] + a]
        residual(space, invariant, estimate, origin, values[pose : 2 * pose], seen, xi, J)
        normal_equations(space, own_information, xi, J, block, gradient)
        H[:] = 0.0
        g[:] = 0.0
        for i in range(pose, d + pose):
            g[at[i]] += gradient[i]
            for j in range(pose, i + 1):
                H[at[i], at[j]] += block[i, j]
                if i != j:
                    H[at[j], at[i]] += block[i, j]
        for i in range(m):
            p = i if i < pose else i + pose
            g[p] += vector[i]
            for j in range(m):
                q = j if j < pose else j + pose
                H[p, q] += information_[i, j]
                g[p] += information_[i, j] * (values[q] - start[q])
        A[:] = H[first:, first:]
        if not cholesky(A):
            return False
        largest = _step(space, A, g, first, values)
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
    space, slots = submap.space, submap.slots()
    landmarks = list(front.landmarks)
    if following is not None:
        known = set(landmarks)
        landmarks += [i for i in following.landmarks.tolist() if i in slots and i not in known]
    shared = [i for i in landmarks if i in slots]
    new = [slots[i] + k for i in landmarks[len(front.landmarks) :] for k in range(space.dim)]
    moved = np.zeros(space.pose)
    values = np.concatenate([moved, submap.pose, front.points.ravel(), submap.mean[new]])
    place = np.array([landmarks.index(i) for i in shared], dtype=np.int64)
    estimate, own_information = factor(submap, rows_of(submap, shared))
    H, covariance = np.empty((2, values.shape[0], values.shape[0]))
    if not _settle(
        space.key, submap.invariant, estimate, own_information, place, np.ascontiguousarray(front.information),
        np.ascontiguousarray(front.vector), space.pose if front.fixed else 0, values, H, covariance,
    ):  # fmt: skip
        raise NumericalError(f"submap {submap.number}: what is known of it does not determine its place")
    moved, end, points = values[: space.pose], values[space.pose : 2 * space.pose], values[2 * space.pose :]
    frame = np.array([front.frame])
    retract(space.key, frame, moved[np.newaxis])
    if space.rot == space.dim:  # what was settled is the rotation vector from the front's frame on
        by_vector, rotation = np.eye(values.shape[0]), slice(space.dim, space.pose)
        by_vector[rotation, rotation] = space.left_jacobian(moved[space.dim :])
        covariance = by_vector @ covariance @ by_vector.T
        back = np.linalg.inv(by_vector)
        H = back.T @ H @ back
    points = points.reshape(-1, space.dim)
    return Joint(submap, space.as_pose(frame[0]), space.as_pose(end), landmarks, shared, points, covariance, H)


def _is_flat(submap: Submap) -> bool:
    """Whether a sub-map says nothing of its end: there was no motion model."""
    first = submap.space.dim  # of the rotation
    return bool(submap.packed[first * (first + 1) // 2 + first] > (2.0 * np.pi) ** 2)


def _marginal(joint: Joint, D: Floats, kept: NDArray[np.int64], fixed: bool) -> Floats:
    """Information of (the end, ``kept`` points in it), what else there is marginalised.

    Beside an end that may be anywhere, what is known of the points would drown in a covariance; an
    information only lacks a few directions.
    """
    space, size = joint.submap.space, D.shape[1]
    own = 2 * space.pose + (space.dim * kept[:, np.newaxis] + np.arange(space.dim)).ravel()
    rest = np.setdiff1d(np.arange(2 * space.pose, size), own)
    gone = rest if fixed else np.concatenate([np.arange(space.pose), rest])
    entries = np.arange(space.pose if fixed else 0, size)
    back = np.linalg.inv(np.vstack([D, np.eye(size)[gone]])[:, entries])
    H = back.T @ joint.information[np.ix_(entries, entries)] @ back
    count = D.shape[0]
    H = H[:count, :count] - H[:count, count:] @ np.linalg.solve(H[count:, count:], H[count:, :count])
    return 0.5 * (H + H.T)


def advance(front: Front, submap: Submap, following: Submap) -> Front:
    """The front of ``following``, whose frame is the end of the closed ``submap``."""
    space, joint = submap.space, condition(front, submap, following)
    after = set(following.landmarks.tolist())
    kept = np.array([i for i, number in enumerate(joint.landmarks) if number in after], dtype=np.int64)
    points = np.empty((kept.shape[0], space.dim))
    D = np.zeros((space.pose + points.size, joint.covariance.shape[0]))
    onward(space.key, np.array(joint.frame), np.array(joint.end), joint.points, kept, points, D)
    if _is_flat(submap):
        known = _marginal(joint, D, kept, front.fixed)
    else:
        known = _inverse(submap, np.ascontiguousarray(D @ joint.covariance @ D.T))
    frame, landmarks = space.compose(joint.frame, joint.end), [joint.landmarks[i] for i in kept.tolist()]
    # Converged: no gradient is left.
    return Front(frame, landmarks, points, known, np.zeros(known.shape[0]), False)
