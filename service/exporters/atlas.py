"""A map's estimate as arrays, read from a service: what a picture is drawn from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.client import Client, Refused, path_of
from service.wire.poses import point_of, pose_of
from submaps.geometry.space import PLANE, SOLID, SPACES, Space
from submaps.trajectory import Trajectory

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Track:
    """A robot's filtered poses in ``map``, and the sub-map (n,) of each."""

    robot: str
    trajectory: Trajectory
    submap: NDArray[np.int64]


@dataclass(frozen=True)
class Atlas:
    """All of a map that a picture shows, in the frame ``map``.

    ``frames`` (k, 3) are the sub-maps' origins, in space (k, 6); ``landmarks`` (n, d) have the covariances
    (n, d, d) in m². ``unconnected`` robots have no place in ``map`` yet.
    """

    name: str
    counts: dict[str, int]
    tracks: list[Track]
    frames: Floats
    landmarks: Floats
    covariances: Floats
    unconnected: list[str]

    @property
    def space(self) -> Space:
        """The plane or space that it lies in."""
        return PLANE if self.frames.shape[1] == PLANE.pose else SOLID


def read_atlas(client: Client, map_: str) -> Atlas:
    """Read a map from a service; raises what the client raises."""
    path = path_of(map_)
    answer = client.request("GET", path)
    space = SPACES[answer["config"].get("space", "se2")]
    tracks, unconnected = read_tracks(client, map_)
    poses = [one["pose"] for one in client.pages(f"{path}/submaps", "submaps") if one["pose"]]
    landmarks = client.landmarks(map_)
    return Atlas(
        name=map_,
        counts=answer["counts"],
        tracks=tracks,
        frames=np.array([pose_of(p) for p in poses]).reshape(-1, space.pose),
        landmarks=np.array([point_of(one) for one in landmarks]).reshape(-1, space.dim),
        covariances=np.array([one["covariance"] for one in landmarks]).reshape(-1, space.dim, space.dim),
        unconnected=unconnected,
    )


def read_tracks(client: Client, map_: str) -> tuple[list[Track], list[str]]:
    """Where each robot has been in ``map``, and the robots that have no place there yet."""
    tracks, unconnected = [], []
    for robot in client.robots(map_):
        try:
            tracks.append(_track(client, map_, robot["id"]))
        except Refused as refusal:
            if refusal.status != 409:
                raise
            unconnected.append(robot["id"])
    return tracks, unconnected


def _track(client: Client, map_: str, robot: str) -> Track:
    poses = client.request("GET", f"{path_of(map_, robot)}/trajectory?frame=map")["poses"]
    t = np.array([p["t"] for p in poses], dtype=np.float64)
    pose = np.array([pose_of(p) for p in poses])  # a robot exists from its first batch, so there are some
    return Track(robot, Trajectory(t, pose), np.array([p["submap"] for p in poses], dtype=np.int64))
