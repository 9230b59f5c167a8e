"""Reader of trajectories in the format of TUM: lines ``t x y z qx qy qz qw``, of which the plane counts."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from service.datasets.dataset import DatasetError
from service.datasets.lines import BadLine, finite, opened
from submaps.trajectory import Trajectory


def read_tum(path: Path) -> Trajectory:
    """Read one file: positions x and y, and the yaw of each quaternion, in order of time.

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
    t, x, y, _, qx, qy, qz, qw = np.array(rows)[np.argsort([row[0] for row in rows], kind="stable")].T
    # R[1, 0] and R[0, 0] of the rotation, both times the squared length of the quaternion.
    yaw = np.arctan2(2.0 * (qw * qz + qx * qy), qw * qw + qx * qx - qy * qy - qz * qz)
    return Trajectory(t, np.column_stack([x, y, yaw]))
