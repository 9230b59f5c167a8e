"""Answers about robots, landmarks, sub-maps and the graph."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from service.wire.base import Wire, example

Covariance = list[list[float]]


_POSE = {"x": 12.5, "y": -3.25, "theta": 0.5}
_SPATIAL_POSE = {"x": 12.5, "y": -3.25, "z": 0.75, "quaternion": [0.0, 0.0, 0.24740396, 0.96891242]}
_COVARIANCE6 = [[0.01 * (i == j) for j in range(6)] for i in range(6)]
_COVARIANCE3 = [[0.01, 0.0, 0.0], [0.0, 0.01, 0.0], [0.0, 0.0, 1e-4]]
_COVARIANCE2 = [[0.04, 0.0], [0.0, 0.04]]


class Pose(Wire):
    """A pose, or the transform that takes coordinates in one frame to another."""

    x: float = Field(description="m")
    y: float = Field(description="m")
    theta: float = Field(description="rad, counter-clockwise")


class SpatialPose(Wire):
    """A pose in space, or the transform that takes coordinates in one frame to another, in a map in se3."""

    x: float = Field(description="m")
    y: float = Field(description="m")
    z: float = Field(description="m")
    quaternion: list[float] = Field(min_length=4, max_length=4, description="unit quaternion x, y, z, w")


_OF_A_POSE = (
    "of the errors of x, y and theta along the frame's axes; in se3 6x6, of x, y, z and of the rotation about the "
    "frame's axes, R = exp(e) R of the estimate"
)

_ROBOT = {
    "id": "r1", "submap": 3, "t": 694.2, "steps": 6942, "observations": 3640, "rejected": 0, "connected": True,
    "pose": {"frame": "submap/3", **_POSE},
}  # fmt: skip


class RobotAnswer(Wire):
    """A robot."""

    model_config = example(**_ROBOT)

    class SubmapPose(Pose):
        """A pose in a sub-map's frame."""

        frame: str

    class SpatialSubmapPose(SpatialPose):
        """A pose in space in a sub-map's frame."""

        frame: str

    id: str
    submap: int = Field(description="its active sub-map")
    t: float = Field(description="time of its last step, s")
    steps: int
    observations: int = Field(description="that were used, encounters included")
    rejected: int
    connected: bool = Field(description="whether ties, or its start, lead from `map` to it")
    pose: SubmapPose | SpatialSubmapPose


class RobotList(Wire):
    """A page of a map's robots, in the order of their first batches."""

    model_config = example(robots=[_ROBOT], next=None)

    robots: list[RobotAnswer]
    next: str | None


class Estimated(Wire):
    """What is told with a robot's pose."""

    frame: str
    t: float
    covariance: Covariance = Field(description=_OF_A_POSE)
    covariance_kind: Literal["joined", "path", "filtered", "dead_reckoning"]
    submap: int
    map_version: int


_ESTIMATED = {"frame": "map", "t": 694.2, "covariance_kind": "joined", "submap": 3, "map_version": 12}


class PoseAnswer(Pose, Estimated):
    """Where a robot is, in a map in se2."""

    model_config = example(
        **_POSE, **_ESTIMATED, covariance=_COVARIANCE3, map_T_odom={"x": 0.2, "y": 0.1, "theta": 0.03}
    )

    map_T_odom: Pose | None = Field(None, description="only for `map`")


class SpatialPoseAnswer(SpatialPose, Estimated):
    """Where a robot is, in a map in se3."""

    model_config = example(
        **_SPATIAL_POSE, **_ESTIMATED, covariance=_COVARIANCE6,
        map_T_odom={"x": 0.2, "y": 0.1, "z": 0.0, "quaternion": [0.0, 0.0, 0.0, 1.0]},
    )  # fmt: skip

    map_T_odom: SpatialPose | None = Field(None, description="only for `map`, and where the robot's motion is measured")


class TrackPose(Pose):
    """A pose of a trajectory, and the sub-map whose filter gave it."""

    t: float
    submap: int


class SpatialTrackPose(SpatialPose):
    """A pose of a trajectory in space, and the sub-map whose filter gave it."""

    t: float
    submap: int


class Trajectory(Wire):
    """Where a robot has been."""

    model_config = example(
        robot="r1", frame="map", kind="filtered", map_version=12, poses=[{"t": 0.1, **_POSE, "submap": 0}]
    )

    robot: str
    frame: str
    kind: Literal["filtered"]
    map_version: int
    poses: list[TrackPose] | list[SpatialTrackPose]


class LandmarkBody(Wire):
    """A landmark."""

    id: str
    x: float = Field(description="m")
    y: float = Field(description="m")
    z: float = Field(0.0, description="m; in a map in se3 only")
    covariance: Covariance = Field(description="2x2, in se3 3x3, along the frame's axes")
    submaps: list[int] = Field(description="the sub-maps that hold it")


class LandmarkAnswer(LandmarkBody):
    """A landmark, with its frame."""

    model_config = example(id="7", x=11.5, y=-3.2, covariance=_COVARIANCE2, submaps=[0, 3], frame="map", map_version=12)

    frame: str
    map_version: int


class LandmarkList(Wire):
    """A page of a map's landmarks, in the order of their first sightings."""

    model_config = example(
        frame="map", map_version=12, next=None, not_connected=0,
        landmarks=[{"id": "7", "x": 11.5, "y": -3.2, "covariance": _COVARIANCE2, "submaps": [0, 3]}],
    )  # fmt: skip

    frame: str
    map_version: int
    not_connected: int = Field(description="landmarks that have no place in the frame: no tie leads to them")
    landmarks: list[LandmarkBody]
    next: str | None


_SUBMAP = {
    "id": 3, "robot": "r1", "active": True, "pose": _POSE, "covariance": _COVARIANCE3, "landmarks": 12, "steps": 140,
    "observations": 75, "nis": 0.98, "began": 680.2, "ended": None,
}  # fmt: skip


class SubmapAnswer(Wire):
    """A sub-map; ``pose`` is its frame's in `map`."""

    id: int
    robot: str
    active: bool
    pose: Pose | SpatialPose | None = Field(description="its frame in `map`; null where no tie leads there yet")
    covariance: Covariance | None = Field(description=_OF_A_POSE)
    landmarks: int
    steps: int
    observations: int
    nis: float | None = Field(description="mean normalised innovation squared per degree of freedom")
    began: float = Field(description="s")
    ended: float | None = Field(description="s; null while active")


class LocalPose(Pose):
    """A pose with its covariance."""

    covariance: Covariance


class SpatialLocalPose(SpatialPose):
    """A pose in space with its covariance."""

    covariance: Covariance


class LocalLandmark(Wire):
    """A landmark in its sub-map's own frame."""

    id: str
    x: float
    y: float
    z: float = Field(0.0, description="m; in a map in se3 only")
    covariance: Covariance


class SubmapDetail(SubmapAnswer):
    """A sub-map with what it holds, in its own frame."""

    model_config = example(
        **_SUBMAP, robot_pose={**_POSE, "covariance": _COVARIANCE3},
        local_landmarks=[{"id": "7", "x": 4.5, "y": 1.25, "covariance": _COVARIANCE2}], untied=[],
    )  # fmt: skip

    robot_pose: LocalPose | SpatialLocalPose
    local_landmarks: list[LocalLandmark]
    untied: list[str] = Field(description="landmarks whose first sighting here does not agree with the map")


class SubmapList(Wire):
    """A page of a map's sub-maps, oldest first."""

    model_config = example(submaps=[_SUBMAP], next=None)

    submaps: list[SubmapAnswer]
    next: str | None


class Node(Wire):
    """A sub-map as a node of the graph."""

    id: int
    robot: str
    active: bool


class EdgeAnswer(Wire):
    """What ties two sub-maps together."""

    kind: Literal["exit", "tie"]
    a: int
    b: int
    transform: Pose | SpatialPose = Field(description="T_a_b")
    covariance: Covariance = Field(description=_OF_A_POSE)


class Graph(Wire):
    """The atlas as a graph."""

    model_config = example(
        map_version=12, nodes=[{"id": 0, "robot": "r1", "active": False}, {"id": 1, "robot": "r1", "active": True}],
        edges=[{"kind": "exit", "a": 0, "b": 1, "transform": _POSE, "covariance": _COVARIANCE3}],
    )  # fmt: skip

    map_version: int
    nodes: list[Node]
    edges: list[EdgeAnswer]


class TransformAnswer(Wire):
    """T_from_to, composed along the path of least uncertainty."""

    model_config = example(
        **{"from": 0}, to=3, transform=_POSE, covariance=_COVARIANCE3, path=[0, 1, 3], map_version=12
    )  # fmt: skip

    from_: int = Field(alias="from")
    to: int
    transform: Pose | SpatialPose
    covariance: Covariance = Field(description=_OF_A_POSE)
    path: list[int]
    map_version: int
