"""Reader of the text format of iSAM: a chain of poses and the landmarks seen from them.

Each line is ``NAME id1 id2 measurement noise``, the noise an upper triangle in row order::

    ODOMETRY  pose pose      dx dy dtheta  n11 n12 n13 n22 n23 n33     (or EDGE2)
    LANDMARK  pose landmark  x y           n11 n12 n22

iSAM writes the square root U of the information (Λ = UᵀU), some copies write the covariance.
Pose k, in the order of the chain, is step k, read at t = k seconds: the format holds no times, and
an odometry model needs none. Step 0 is the first pose and has no control; the observations made
from a pose belong to its step, after the motion that led there, wherever their lines stand.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from service.datasets.dataset import Dataset, DatasetError
from service.datasets.lines import BadLine, LineNoise, NoiseForm, finite, number, opened
from submaps.config import MotionConfig, ObservationConfig
from submaps.measurements import Batch

STEP_SECONDS = 1.0
_MOTIONS = ("ODOMETRY", "EDGE2")
_LAYOUT = {
    3: "two pose ids, dx dy dtheta, and 6 numbers of noise (upper triangle)",
    2: "a pose id, a landmark id, x y, and 3 numbers of noise (upper triangle)",
}


def read_isam(path: Path, *, noise: NoiseForm = "sqrt_information", name: str | None = None) -> Dataset:
    """Read one file; raises ``DatasetError``, naming the line, if any line is not as expected."""
    with opened(path) as lines:
        return parse_isam(lines, noise=noise, name=name or path.stem, source=str(path))


def parse_isam(lines: Iterable[str], *, noise: NoiseForm, name: str, source: str) -> Dataset:
    """Parse lines of the format; ``source`` is what the errors call the file."""
    run = _Run(LineNoise(noise, 3), LineNoise(noise, 2))
    for k, line in enumerate(lines, start=1):
        fields = line.split()
        if not fields or fields[0].startswith("#"):
            continue
        try:
            run.read(fields)
        except BadLine as error:
            raise DatasetError(f"{source}:{k}: {error}") from None
    if not run.controls or not run.seen:
        raise DatasetError(f"{source}: expected ODOMETRY (or EDGE2) and LANDMARK lines, found no such line of one kind")
    return run.dataset(name)


@dataclass
class _Run:
    """What has been read so far."""

    motion_noise: LineNoise
    observation_noise: LineNoise
    step_of_pose: dict[int, int] = field(default_factory=dict)
    controls: list[tuple[float, ...]] = field(default_factory=list)
    seen: list[tuple[int, str]] = field(default_factory=list)
    z: list[tuple[float, ...]] = field(default_factory=list)
    last_pose: int = 0

    def read(self, fields: list[str]) -> None:
        if fields[0] in _MOTIONS:
            self._motion(fields)
        elif fields[0] == "LANDMARK":
            self._observation(fields)
        else:
            raise BadLine(f"expected ODOMETRY, EDGE2 or LANDMARK, got {fields[0]!r}")

    def _motion(self, fields: list[str]) -> None:
        numbers = _numbers(fields, 3)
        before, after = number(fields[1], int, "a pose id"), number(fields[2], int, "a pose id")
        self._begin(before)
        if before != self.last_pose or after in self.step_of_pose:
            raise BadLine(
                f"expected an edge from pose {self.last_pose}, the last one, to a new pose, got {before} to {after}"
            )
        self.motion_noise.add(numbers[3:])
        self.controls.append(numbers[:3])
        self.step_of_pose[after] = len(self.step_of_pose)
        self.last_pose = after

    def _observation(self, fields: list[str]) -> None:
        numbers = _numbers(fields, 2)
        pose = number(fields[1], int, "a pose id")
        self._begin(pose)
        if pose not in self.step_of_pose:
            raise BadLine(f"expected the id of a pose that an earlier line leads to, got {pose}")
        self.observation_noise.add(numbers[2:])
        self.seen.append((self.step_of_pose[pose], fields[2]))
        self.z.append(numbers[:2])

    def _begin(self, pose: int) -> None:
        """The first pose that the file names is step 0."""
        if not self.step_of_pose:
            self.step_of_pose[pose] = 0
            self.last_pose = pose

    def dataset(self, name: str) -> Dataset:
        steps = len(self.step_of_pose)
        order = sorted(range(len(self.seen)), key=lambda i: self.seen[i][0])  # stable: file order within a step
        columns = Batch(
            t=STEP_SECONDS * np.arange(steps, dtype=np.float64),
            control_step=np.arange(1, steps, dtype=np.int64),
            control=np.ascontiguousarray(np.array(self.controls).T),
            control_covariance=self.motion_noise.covariances(range(steps - 1)),
            observation_step=np.array([self.seen[i][0] for i in order], dtype=np.int64),
            landmark=tuple(self.seen[i][1] for i in order),
            z=np.ascontiguousarray(np.array([self.z[i] for i in order]).T),
            observation_covariance=self.observation_noise.covariances(order),
        )
        motion = MotionConfig("odometry", self.motion_noise.sigma())
        observation = ObservationConfig("cartesian", self.observation_noise.sigma())
        return Dataset.single(name, motion, observation, columns)


def _numbers(fields: list[str], size: int) -> tuple[float, ...]:
    expected = 3 + size + size * (size + 1) // 2
    if len(fields) != expected:
        layout = _LAYOUT[size]
        raise BadLine(f"{fields[0]} takes {expected} fields ({layout}), got {len(fields)}")
    return finite(fields[3:])
