"""Reader of g2o's text format in the plane: poses, what led from one to the next, landmarks seen from them.

The lines it knows, each information an upper triangle in row order::

    VERTEX_SE2   pose  x y theta
    VERTEX_XY    landmark  x y
    EDGE_SE2     pose pose      dx dy dtheta  i11 i12 i13 i22 i23 i33
    EDGE_SE2_XY  pose landmark  x y           i11 i12 i22
    FIX          id

Poses follow one another by their ids: step k is the k-th pose, at t = k seconds, and the edge from
the pose before it is its odometry. An edge between poses that do not follow one another closes a
loop; it is no measurement of a robot's, so such edges are left out and counted in ``notes``. Values
of vertices are begin values of a solver, and are left out as well.

g2o's error of an edge is (R(dtheta)ᵀ(t - d), theta - dtheta): it stands in the axes of the later pose,
where an odometry's noise stands in those of the earlier one, so its covariance is turned by dtheta
(Kümmerle, Grisetti et al., "g2o: A general framework for graph optimization", ICRA 2011).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from service.datasets.dataset import ROBOT, Dataset, DatasetError
from service.datasets.lines import BadLine, LineNoise, finite, number, opened
from submaps.config import MapConfig, MotionConfig, ObservationConfig
from submaps.measurements import Batch

STEP_SECONDS = 1.0
CLOSINGS = "edges between poses that do not follow one another"
_FIELDS = {
    "VERTEX_SE2": (5, "a pose id, x y theta"),
    "VERTEX_XY": (4, "a landmark id, x y"),
    "EDGE_SE2": (12, "two pose ids, dx dy dtheta, and 6 numbers of information (upper triangle)"),
    "EDGE_SE2_XY": (8, "a pose id, a landmark id, x y, and 3 numbers of information (upper triangle)"),
}


def is_g2o(path: Path) -> bool:
    """Whether the first line of a file that says something is one of this format."""
    with opened(path) as lines:
        words = (line.split() for line in lines)
        first = next((fields[0] for fields in words if fields and not fields[0].startswith("#")), "")
    return first in _FIELDS or first == "FIX"


def read_g2o(path: Path) -> Dataset:
    """Read one file; raises ``DatasetError``, naming the line, if any line is not as expected."""
    with opened(path) as lines:
        return parse_g2o(lines, name=path.stem, source=str(path))


def parse_g2o(lines: Iterable[str], *, name: str, source: str) -> Dataset:
    """Parse lines of the format; ``source`` is what the errors call the file."""
    run = _Run()
    for k, line in enumerate(lines, start=1):
        fields = line.split()
        if not fields or fields[0].startswith("#") or fields[0] == "FIX":
            continue
        try:
            run.read(fields)
        except BadLine as error:
            raise DatasetError(f"{source}:{k}: {error}") from None
    try:
        return run.dataset(name)
    except BadLine as error:
        raise DatasetError(f"{source}: {error}") from None


@dataclass
class _Run:
    """What has been read so far, edge by edge."""

    poses: set[int] = field(default_factory=set)
    moves: list[tuple[int, int]] = field(default_factory=list)
    controls: list[tuple[float, ...]] = field(default_factory=list)
    motion_noise: LineNoise = field(default_factory=lambda: LineNoise("information", 3))
    seen: list[tuple[int, str]] = field(default_factory=list)
    z: list[tuple[float, ...]] = field(default_factory=list)
    observation_noise: LineNoise = field(default_factory=lambda: LineNoise("information", 2))

    def read(self, fields: list[str]) -> None:
        kind = fields[0]
        if kind not in _FIELDS:
            raise BadLine(f"expected one of {', '.join(_FIELDS)} or FIX, got {kind!r}")
        count, layout = _FIELDS[kind]
        if len(fields) != count:
            raise BadLine(f"{kind} takes {count} fields ({layout}), got {len(fields)}")
        if kind == "EDGE_SE2":
            self._motion(fields)
        elif kind == "EDGE_SE2_XY":
            self._observation(fields)
        elif kind == "VERTEX_SE2":
            self.poses.add(number(fields[1], int, "a pose id"))

    def _motion(self, fields: list[str]) -> None:
        before, after = number(fields[1], int, "a pose id"), number(fields[2], int, "a pose id")
        numbers = finite(fields[3:])
        triangle = numbers[3:]
        same_both_ways = triangle[0] == triangle[3] and not any((triangle[1], triangle[2], triangle[4]))
        self.motion_noise.add(triangle, 0.0 if same_both_ways else numbers[2])
        self.poses |= {before, after}
        self.moves.append((before, after))
        self.controls.append(numbers[:3])

    def _observation(self, fields: list[str]) -> None:
        pose = number(fields[1], int, "a pose id")
        numbers = finite(fields[3:])
        self.observation_noise.add(numbers[2:])
        self.poses.add(pose)
        self.seen.append((pose, fields[2]))
        self.z.append(numbers[:2])

    def dataset(self, name: str) -> Dataset:
        if not self.seen:
            raise BadLine(
                "holds no landmarks (no line EDGE_SE2_XY): a graph of poses alone has no measurements to make a map of"
            )
        chain = sorted(self.poses)
        odometry, closings = self._chain(chain)
        step_of = {pose: k for k, pose in enumerate(chain)}
        order = sorted(range(len(self.seen)), key=lambda i: step_of[self.seen[i][0]])
        columns = Batch(
            t=STEP_SECONDS * np.arange(len(chain), dtype=np.float64),
            control_step=np.arange(1, len(chain), dtype=np.int64),
            control=np.ascontiguousarray(np.array([self.controls[i] for i in odometry]).reshape(-1, 3).T),
            control_covariance=self.motion_noise.covariances(odometry) if odometry else None,
            observation_step=np.array([step_of[self.seen[i][0]] for i in order], dtype=np.int64),
            landmark=tuple(self.seen[i][1] for i in order),
            z=np.ascontiguousarray(np.array([self.z[i] for i in order]).T),
            observation_covariance=self.observation_noise.covariances(order),
        )
        motion = MotionConfig("odometry", self.motion_noise.sigma() if odometry else (1.0, 1.0, 1.0))
        config = MapConfig(motion, ObservationConfig("cartesian", self.observation_noise.sigma()))
        return Dataset(name, config, {ROBOT: columns}, notes={CLOSINGS: closings} if closings else {})

    def _chain(self, chain: list[int]) -> tuple[list[int], int]:
        """The edge that leads to each pose but the first, and the number of all others."""
        edge_of: dict[tuple[int, int], int] = {}
        for i, ends in enumerate(self.moves):
            edge_of.setdefault(ends, i)
        links = list(itertools.pairwise(chain))
        for before, after in links:
            if (before, after) not in edge_of:
                raise BadLine(f"expected an EDGE_SE2 from pose {before} to {after}, the next one, found none")
        return [edge_of[link] for link in links], len(self.moves) - len(links)
