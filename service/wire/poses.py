"""Poses and points as messages hold them: the one place where they are turned into the estimator's form and back.

The estimator's pose is (x m, y m, theta rad), in space (x, y, z m and a rotation vector, rad); a
message says the rotation in space as a unit quaternion (x, y, z, w), w not below 0 in answers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.problems import invalid
from submaps.geometry import so3
from submaps.geometry.space import PLANE, Pose

Floats = NDArray[np.float64]

# By so much may the length of a quaternion differ from 1: enough for one that was rounded to four digits.
ROUNDING = 1e-3


def pose_answer(pose: Pose) -> dict[str, Any]:
    """Return a pose by name: x, y and theta, or x, y, z and quaternion."""
    if len(pose) == PLANE.pose:
        return {"x": pose[0], "y": pose[1], "theta": pose[2]}
    x, y, z, *rotation = pose
    return {"x": x, "y": y, "z": z, "quaternion": so3.quaternion(*rotation)}


def point_answer(point: Floats) -> dict[str, float]:
    """Return a point (2,) or (3,) by name: x, y and, in space, z."""
    return dict(zip(("x", "y", "z"), point.tolist(), strict=False))


def tum_rest(pose: Pose) -> str:
    """Return a pose as a line of TUM's format holds it after the time: ``x y z qx qy qz qw``."""
    if len(pose) == PLANE.pose:
        x, y, theta = pose
        return f"{x!r} {y!r} 0 0 0 {math.sin(theta / 2):.17g} {math.cos(theta / 2):.17g}"
    x, y, z, *rotation = pose
    return " ".join(map(repr, (x, y, z, *so3.quaternion(*rotation))))


def pose_of(answer: Mapping[str, Any]) -> Pose:
    """Return the estimator's form of ``pose_answer``."""
    if "theta" in answer:
        return answer["x"], answer["y"], answer["theta"]
    return answer["x"], answer["y"], answer["z"], *rotation_of(answer["quaternion"])


def point_of(answer: Mapping[str, Any]) -> tuple[float, ...]:
    """Return the coordinates of ``point_answer``."""
    return tuple(answer[name] for name in ("x", "y", "z") if name in answer)


def rotation_of(quaternion: Sequence[float]) -> tuple[float, float, float]:
    """Return the rotation vector of a quaternion."""
    x, y, z, w = quaternion
    return so3.rotation_vector((float(x), float(y), float(z), float(w)))


def unit_quaternion(path: str, given: Sequence[float]) -> tuple[float, ...]:
    """Return a quaternion with its length brought to 1; raises ``Problem`` (422) where it is far from that."""
    length = math.hypot(*given)
    if len(given) != 4 or not abs(length - 1.0) < ROUNDING:
        raise invalid(path, f"got {list(given)}, expected a unit quaternion (x, y, z, w)")
    return tuple(value / length for value in given)
