"""One component of the atlas as a least-squares problem: flat arrays for the compiled assembly.

Variables are numbered: the sub-maps' frames in order of the sub-maps' numbers (but the root, which is
fixed), the present poses of the robots in the component, then the landmarks that at least two sub-maps
hold.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.atlas.coordinates import retract
from submaps.atlas.factors import factor, normal_equations, residual, rows_of
from submaps.atlas.placed import Placed
from submaps.atlas.sparse import InverseSubset, Pattern, scatter
from submaps.geometry.space import Key, Pose, Space
from submaps.submap import Submap

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
FIXED = -1
Part = tuple[Submap, Ints, Floats, Floats]


@dataclass(frozen=True)
class Link:
    """What a robot's start says: the frame of its first sub-map, in that of another (``None``: the root).

    ``information`` (pose, pose) is of the error that factors speak of (see ``atlas.factors``), ``invariant``
    which of the two that is.
    """

    frame: int | None
    first: int
    pose: Pose
    information: Floats
    invariant: bool


_ASSEMBLE = (
    "float64(UniTuple(int64, {}), int64, int64, boolean[::1], int64[::1], int64[::1], int64[::1], int64[::1],"
    "float64[::1], float64[::1], float64[:, ::1], float64[:, ::1], int64[::1], int64[::1], int64[::1], int64[::1],"
    "int32[::1], float64[::1], float64[::1])"
)


@jit(_ASSEMBLE.format(2), _ASSEMBLE.format(3), unlocked=True)
def _assemble(
    space: Key, first: int, last: int, invariant: NDArray[np.bool_], variable_at: Ints, variables: Ints,
    estimate_at: Ints, information_at: Ints, estimates: Floats, informations: Floats, frames: Floats, points: Floats,
    begins: Ints, rows: Ints, within: Ints, start: Ints, pointers: NDArray[np.int32],
    data: Floats, gradient: Floats,
) -> float:  # fmt: skip
    """Add factors ``first`` .. ``last`` - 1 at the given values to the normal equations; their cost."""
    cost = 0.0
    poses, dim, pose = frames.shape[0] - 1, points.shape[1], frames.shape[1]
    for f in range(first, last):
        own = variables[variable_at[f] : variable_at[f + 1]]
        estimate = estimates[estimate_at[f] : estimate_at[f + 1]]
        d = estimate.shape[0]
        information = informations[information_at[f] : information_at[f + 1]].reshape(d, d)
        seen = np.empty((own.shape[0] - 2, dim))
        for i in range(seen.shape[0]):
            for a in range(dim):
                seen[i, a] = points[own[i + 2] - poses, a]
        xi = np.empty(d)
        J = np.empty((d, 2 * pose + dim))
        residual(space, invariant[f], estimate, frames[own[0] + 1], frames[own[1] + 1], seen, xi, J)
        H = np.empty((d + pose, d + pose))
        g = np.empty(d + pose)
        cost += normal_equations(space, information, xi, J, H, g)
        scatter(own, H, g, begins, rows, within, start, pointers, data, gradient)
    return cost


class Component:
    """Sub-maps of one or more robots as factors over frames and shared landmarks.

    ``members`` are in order of their numbers; the first one's frame is the root, unless it has a start
    itself. ``total`` (landmarks,) says how many sub-maps of the whole atlas hold each landmark: those
    that sub-maps outside hold as well are kept, for components may meet. The pairs (sub-map,
    landmark) in ``untied`` are private to their sub-maps. ``known`` has parts of the last solve,
    taken over where nothing changed.
    """

    def __init__(
        self, members: list[Submap], total: Ints, untied: Collection[tuple[int, int]], links: Sequence[Link],
        known: Mapping[int, Part],
    ) -> None:  # fmt: skip
        self.members = members
        self.space = members[0].space
        self.numbers = np.array([s.number for s in members], dtype=np.int64)
        self.links = {link.first: link for link in links}
        self._index_frames()
        self._find_shared(total, untied)
        self.parts = [self._part(f, known.get(s.number)) for f, s in enumerate(members)]
        self._flatten()
        self.frames = np.zeros((self.poses + 1, self.space.pose))
        self.points = np.full((len(self.landmarks), self.space.dim), np.nan)

    def _index_frames(self) -> None:
        """Rows of ``frames`` for each member's frame and end: row 0 is the root."""
        count = len(self.members)
        following = np.array([s.following for s in self.members], dtype=np.int64)
        rooted = self.members[0].number not in self.links
        self.frame_at = np.arange(count, dtype=np.int64) + (0 if rooted else 1)
        active = following < 0
        self.end_at = self.frame_at[np.searchsorted(self.numbers, np.where(active, self.numbers, following))]
        self.end_at[active] = self.frame_at[-1] + 1 + np.arange(np.count_nonzero(active))
        self.poses = int(self.frame_at[-1]) + int(np.count_nonzero(active))

    def _find_shared(self, total: Ints, untied: Collection[tuple[int, int]]) -> None:
        lengths = np.array([s.landmarks.shape[0] for s in self.members], dtype=np.int64)
        every = np.concatenate([s.landmarks for s in self.members]).astype(np.int64)
        at = _offsets(lengths)
        own = np.ones(every.shape[0], dtype=bool)
        for number, landmark in untied:
            if self.has(number):
                f = self.at(number)
                own[at[f] : at[f + 1]] &= every[at[f] : at[f + 1]] != landmark
        self._every, self._every_owner = every, np.repeat(np.arange(len(self.members)), lengths)
        outside = total - np.bincount(every, minlength=total.shape[0])
        held = outside + np.bincount(every[own], minlength=total.shape[0])
        tied = own & (held[every] > 1)
        self._owner = self._every_owner[tied]
        self._shared_landmark = every[tied]
        self._shared_at = _offsets(np.bincount(self._owner, minlength=len(self.members)))
        unique, rows = np.unique(self._shared_landmark, return_inverse=True)
        self.landmarks: list[int] = unique.tolist()
        self._rows = rows.reshape(-1).astype(np.int64)

    def _part(self, f: int, known: Part | None) -> Part:
        """Estimate and information of a member, taken over where the last solve had the same."""
        submap, shared = self.members[f], self._shared_of(f)
        if known is not None and known[0] is submap and np.array_equal(known[1], shared):
            return known
        return (submap, shared, *factor(submap, rows_of(submap, shared.tolist())))

    def _flatten(self) -> None:
        """Lay the factors out for the compiled assembly: each member's, its link's before it."""
        variables = self.poses + self._rows
        own, estimates, informations, invariant = [], [], [], []
        self._upto = []
        for f, (submap, _, estimate, information) in enumerate(self.parts):
            link = self.links.get(submap.number)
            if link is not None:
                own.append(np.array([self._link_from(link) - 1, self.frame_at[f] - 1]))
                estimates.append(np.array(link.pose))
                informations.append(link.information)
                invariant.append(link.invariant)
            shared = variables[self._shared_at[f] : self._shared_at[f + 1]]
            own.append(np.concatenate([[self.frame_at[f] - 1, self.end_at[f] - 1], shared]))
            estimates.append(estimate)
            informations.append(information)
            invariant.append(submap.invariant)
            self._upto.append(len(own))
        self._invariant = np.array(invariant)
        self._variables = np.concatenate(own).astype(np.int64)
        self._variable_at = _offsets([v.shape[0] for v in own])
        self._estimates = np.concatenate(estimates)
        self._estimate_at = _offsets([e.shape[0] for e in estimates])
        self._informations = np.concatenate([i.ravel() for i in informations])
        self._information_at = _offsets([i.size for i in informations])
        # One copy of each: the parts are looked up in what the assembly reads.
        self.parts = [self._laid_out(part, self._upto[f] - 1) for f, part in enumerate(self.parts)]
        widths = np.repeat([self.space.pose, self.space.dim], [self.poses, len(self.landmarks)]).astype(np.int64)
        self.pattern = Pattern(widths, self._variable_at, self._variables)

    def _laid_out(self, part: Part, factor_: int) -> Part:
        submap, shared, estimate, _ = part
        d = estimate.shape[0]
        at, first = self._estimate_at[factor_], self._information_at[factor_]
        laid_out = self._informations[first : first + d * d].reshape(d, d)
        return submap, shared, self._estimates[at : at + d], laid_out

    def _link_from(self, link: Link) -> int:
        """Row of ``frames`` that a link starts from."""
        return 0 if link.frame is None else int(self.frame_at[self.at(link.frame)])

    # -- who is who --------------------------------------------------------------------------------

    def has(self, number: int) -> bool:
        """Whether a sub-map is a member."""
        f = int(np.searchsorted(self.numbers, number))
        return f < self.numbers.shape[0] and int(self.numbers[f]) == number

    def at(self, number: int) -> int:
        """The place of a sub-map among the members."""
        return int(np.searchsorted(self.numbers, number))

    def _shared_of(self, f: int) -> Ints:
        return self._shared_landmark[self._shared_at[f] : self._shared_at[f + 1]]

    def shared(self, f: int) -> list[int]:
        """The shared landmarks of a member, in its own order."""
        found: list[int] = self._shared_of(f).tolist()
        return found

    def variable_of(self, landmark: int) -> int | None:
        """The variable of a landmark, ``None`` where it is not shared."""
        i = int(np.searchsorted(self.landmarks, landmark)) if self.landmarks else 0
        return self.poses + i if i < len(self.landmarks) and self.landmarks[i] == landmark else None

    def point_rows(self, f: int) -> Ints:
        """Rows of ``points`` of a member's shared landmarks."""
        return self._rows[self._shared_at[f] : self._shared_at[f + 1]]

    def known_parts(self) -> dict[int, Part]:
        """Parts of the members by their numbers, for the next solve."""
        return {part[0].number: part for part in self.parts}

    def holders(self, landmark: int) -> list[int]:
        """Members that hold a landmark, tied or not, in order."""
        found: list[int] = self._every_owner[self._every == landmark].tolist()
        return found

    def near(self, f: int, steps: int) -> list[int]:
        """A member and those up to so many steps before and after it in its robot's chain."""
        found = [f]
        for link in ("previous", "following"):
            at = f
            for _ in range(steps):
                number = getattr(self.members[at], link)
                if number < 0:
                    break
                at = self.at(number)
                found.append(at)
        return found

    def last_holders(self, members: int) -> Ints:
        """For each shared landmark the last of the first ``members`` that holds it, or -1."""
        holder = np.full(len(self.landmarks), -1, dtype=np.int64)
        end = self._shared_at[members]
        np.maximum.at(holder, self._rows[:end], self._owner[:end])
        return holder

    # -- values ------------------------------------------------------------------------------------

    def assemble(self, members: int, data: Floats, gradient: Floats) -> float:
        """Write the normal equations of the first ``members`` factors at the present values; the cost.

        Variables that none of them reaches get a unit pivot and no gradient.
        """
        data[:] = 0.0
        gradient[:] = 0.0
        p = self.pattern
        cost: float = _assemble(
            self.space.key, 0, self._upto[members - 1], self._invariant, self._variable_at, self._variables,
            self._estimate_at, self._information_at, self._estimates, self._informations, self.frames, self.points,
            p.begins, p.rows, p.within, p.start, p.pointers, data, gradient,
        )  # fmt: skip
        unreached = p.diagonal[data[p.diagonal] == 0.0]
        data[unreached] = 1.0
        return cost

    def unplaced(self) -> list[int]:
        """Members with a frame, an end or a landmark that has no value yet, in order."""
        missing = np.isnan(self.frames[self.frame_at, 0]) | np.isnan(self.frames[self.end_at, 0])
        missing[self._owner[np.isnan(self.points[self._rows, 0])]] = True
        found: list[int] = np.flatnonzero(missing).tolist()
        return found

    def place(self, f: int) -> None:
        """First values of what member f reaches and none before it did: its end, its new landmarks."""
        submap, space = self.members[f], self.space
        link = self.links.get(submap.number)
        if link is not None and np.isnan(self.frames[self.frame_at[f], 0]):
            origin = space.as_pose(self.frames[self._link_from(link)])
            self.frames[self.frame_at[f]] = space.compose(origin, link.pose)
        frame = space.as_pose(self.frames[self.frame_at[f]])
        if np.isnan(self.frames[self.end_at[f], 0]):
            self.frames[self.end_at[f]] = space.compose(frame, submap.pose)
        rows, estimates = self.point_rows(f), self.parts[f][2][space.pose :].reshape(-1, space.dim)
        new = np.isnan(self.points[rows, 0])
        if new.any():
            self.points[rows[new]] = space.transform(frame, estimates[new])

    def placed(self, number: int, inverse: InverseSubset) -> Placed:
        """A member at the present values, with the joint covariance of its variables."""
        f = self.at(number)
        rows = self.point_rows(f)
        variables = np.concatenate([[self.frame_at[f] - 1, self.end_at[f] - 1], self.poses + rows])
        space = self.space
        fixed = space.pose if variables[0] == FIXED else 0
        size = 2 * space.pose + space.dim * rows.shape[0]
        covariance = np.zeros((size, size))
        covariance[fixed:, fixed:] = inverse.joint(variables[variables != FIXED])
        frame, end = (space.as_pose(self.frames[at[f]]) for at in (self.frame_at, self.end_at))
        return Placed(self.members[f], frame, end, self.shared(f), self.points[rows], covariance)

    def take(self, other: Component, T: Pose) -> None:
        """Take over another component's values, moved by ``T``, for what both have."""
        mine = np.searchsorted(self.numbers, other.numbers)
        self.frames[self.frame_at[mine]] = _moved(self.space, T, other.frames[other.frame_at])
        self.frames[self.end_at[mine]] = _moved(self.space, T, other.frames[other.end_at])
        self.frames[0] = 0.0
        self.take_points(other, T)
        for f in self.unplaced():
            self.place(f)

    def take_points(self, other: Component, T: Pose) -> None:
        """Take over another component's landmarks, moved by ``T``, where this one has none yet."""
        _, mine, theirs = np.intersect1d(self.landmarks, other.landmarks, return_indices=True)
        missing = np.isnan(self.points[mine, 0])
        self.points[mine[missing]] = self.space.transform(T, other.points[theirs[missing]])

    def move(self, step: Floats) -> None:
        """Add an increment of all variables to their values."""
        space = self.space
        poses = space.pose * self.poses
        retract(space.key, self.frames[1:], np.ascontiguousarray(step[:poses].reshape(-1, space.pose)))
        self.points += step[poses:].reshape(-1, space.dim)


def _moved(space: Space, T: Pose, poses: Floats) -> Floats:
    """T composed with each pose (n, pose)."""
    return np.array([space.compose(T, space.as_pose(pose)) for pose in poses]).reshape(poses.shape)


def _offsets(lengths: Sequence[int] | Ints) -> Ints:
    return np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
