"""Reader of trajectories in the format of TUM: lines ``t x y z qx qy qz qw``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from service.datasets.dataset import DatasetError
from service.datasets.lines import BadLine, finite, opened
from submaps.config import SpaceName
from submaps.trajectory import Trajectory


def read_tum(path: Path, space: SpaceName = "se2") -> Trajectory:
    """Read one file, in order of time: positions x and y, and the yaw of each quaternion; in se3 whole poses.

    Raises ``DatasetError``, naming the line, where one is not as expected.
    """
    rows = []
    with opened(path) as lines:
        for k, line in enumerate(lines, start=1):
            if line.isspace() or line.lstrip().startswith("#"):
                continue
            try:
                row = finite(line.split())
            except BadLine as error:
                raise DatasetError(f"{path}:{k}: {error}") from None
            if len(row) != 8 or not any(row[4:]):
                raise DatasetError(f"{path}:{k}: expected t x y z qx qy qz qw, got {line.strip()!r}")
            rows.append(row)
    if not rows:
        raise DatasetError(f"{path}: expected lines t x y z qx qy qz qw, found none")
    t, x, y, z, qx, qy, qz, qw = np.array(rows)[np.argsort([row[0] for row in rows], kind="stable")].T
    if space == "se3":
        turns = Rotation.from_quat(np.column_stack([qx, qy, qz, qw])).as_rotvec()
        return Trajectory(t, np.column_stack([x, y, z, turns]))
    # R[1, 0] and R[0, 0] of the rotation, both times the squared length of the quaternion.
    yaw = np.arctan2(2.0 * (qw * qz + qx * qy), qw * qw + qx * qx - qy * qy - qz * qz)
    return Trajectory(t, np.column_stack([x, y, yaw]))
