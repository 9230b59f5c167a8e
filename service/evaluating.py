"""What a service says of a map, against the truth of the run that it came from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.client import Client, path_of
from service.datasets import Truth
from service.exporters.atlas import read_tracks
from service.wire.poses import point_of, pose_of
from submaps.alignment import Alignment
from submaps.evaluation import (
    NothingInCommon,
    PointError,
    Statistics,
    Unit,
    absolute_error,
    point_error,
    pose_nees,
    relative_error,
)
from submaps.trajectory import Trajectory, composed

Floats = NDArray[np.float64]

LONGEST_GAP = 0.5  # s between two poses of the truth, for the truth to be known between them


@dataclass(frozen=True)
class RobotError:
    """How far a robot's trajectory lies from the truth.

    ``absolute`` after the best rigid motion of its own, ``common`` after that of the landmarks, which
    all robots share; ``relative`` and ``turn`` of the motion over some way (m, rad).
    """

    absolute: Statistics
    common: Statistics
    relative: Statistics
    turn: Statistics


@dataclass(frozen=True)
class MapError:
    """How far a map lies from the truth: landmarks, trajectories, and the NEES of the robots' last poses.

    ``unconnected`` robots have no place in ``map``; ``pose_nees`` is per degree of freedom, of
    ``poses`` robots whose last pose is known to the truth.
    """

    landmarks: PointError
    robots: dict[str, RobotError]
    unconnected: list[str]
    pose_nees: float | None
    poses: int


def map_error(client: Client, map_: str, truth: Truth, delta: float = 1.0, unit: Unit = "meters") -> MapError:
    """Compare a map with the truth; raises what the client raises, and ``NothingInCommon``."""
    landmarks = landmark_error(client, map_, truth)
    tracks, unconnected = read_tracks(client, map_)
    robots = {}
    for track in tracks:
        known = _known(truth, track.robot, track.trajectory)
        if known is not None:
            robots[track.robot] = _robot_error(*known, landmarks.alignment, delta, unit)
    nees, poses = _last_poses(client, map_, [track.robot for track in tracks], truth, landmarks.alignment)
    return MapError(landmarks, robots, unconnected, nees, poses)


def landmark_error(client: Client, map_: str, truth: Truth) -> PointError:
    """Compare the landmarks in ``map`` with the truth."""
    found = [one for one in client.landmarks(map_) if one["id"] in truth.landmarks]
    true = [truth.landmarks[one["id"]] for one in found]
    dim = len(next(iter(truth.landmarks.values()), (0.0, 0.0)))
    points = [point_of(one) for one in found]
    if any(len(point) != dim for point in points):
        raise NothingInCommon(f"the truth is of points of {dim} coordinates, the map of others")
    covariances = np.array([one["covariance"] for one in found]).reshape(-1, dim, dim)
    return point_error(np.array(points).reshape(-1, dim), covariances, np.array(true).reshape(-1, dim))


def _known(truth: Truth, robot: str, estimate: Trajectory) -> tuple[Trajectory, Trajectory] | None:
    """The part of an estimate that the truth knows, and the truth at its times."""
    if robot not in truth.trajectories:
        return None
    there, known = truth.trajectories[robot].at(estimate.t, LONGEST_GAP)
    return (estimate.take(known), there.take(known)) if known.sum() > 1 else None


def _robot_error(estimate: Trajectory, truth: Trajectory, common: Alignment, delta: float, unit: Unit) -> RobotError:
    turned = composed(common.angles[np.newaxis], estimate.angles)
    moved = Trajectory(estimate.t, np.hstack([common.apply(estimate.positions), turned]))
    relative, turn = relative_error(estimate, truth, delta, unit)
    return RobotError(
        absolute_error(estimate, truth),
        absolute_error(moved, truth, aligned=False),
        relative,
        turn,
    )


def _last_poses(
    client: Client, map_: str, robots: list[str], truth: Truth, common: Alignment
) -> tuple[float | None, int]:
    poses, covariances, true = [], [], []
    for robot in robots:
        answer = client.request("GET", f"{path_of(map_, robot)}/pose?frame=map")
        if robot in truth.trajectories:
            there, known = truth.trajectories[robot].at(np.array([answer["t"]]), LONGEST_GAP)
            if known[0]:
                poses.append(pose_of(answer))
                covariances.append(answer["covariance"])
                true.append(there.poses[0])
    if not poses:
        return None, 0
    return pose_nees(np.array(poses), np.array(covariances), np.array(true), common), len(poses)
