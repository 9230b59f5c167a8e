"""A map's estimate as arrays, read from a service: what a picture is drawn from."""

from __future__ import annotations

from dataclasses import dataclass
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from service.client import Client, Refused

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Track:
    """A robot's filtered poses (n, 3) in ``map`` (m, m, rad), and the sub-map (n,) of each."""

    robot: str
    pose: Floats
    submap: NDArray[np.int64]


@dataclass(frozen=True)
class Atlas:
    """All of a map that a picture shows, in the frame ``map``.

    ``frames`` (k, 3) are the sub-maps' origins; ``landmarks`` (n, 2) have the covariances (n, 2, 2)
    in m². ``unconnected`` robots have no place in ``map`` yet.
    """

    name: str
    counts: dict[str, int]
    tracks: list[Track]
    frames: Floats
    landmarks: Floats
    covariances: Floats
    unconnected: list[str]


def read_atlas(client: Client, map_: str) -> Atlas:
    """Read a map from a service; raises what the client raises."""
    path = f"/v1/maps/{quote(map_, safe='')}"
    counts = client.request("GET", path)["counts"]
    tracks, unconnected = [], []
    for robot in client.pages(f"{path}/robots", "robots"):
        try:
            tracks.append(_track(client, path, robot["id"]))
        except Refused as refusal:
            if refusal.status != 409:
                raise
            unconnected.append(robot["id"])
    poses = [one["pose"] for one in client.pages(f"{path}/submaps", "submaps") if one["pose"]]
    landmarks = list(client.pages(f"{path}/landmarks", "landmarks", frame="map"))
    return Atlas(
        name=map_,
        counts=counts,
        tracks=tracks,
        frames=np.array([[p["x"], p["y"], p["theta"]] for p in poses]).reshape(-1, 3),
        landmarks=np.array([[one["x"], one["y"]] for one in landmarks]).reshape(-1, 2),
        covariances=np.array([one["covariance"] for one in landmarks]).reshape(-1, 2, 2),
        unconnected=unconnected,
    )


def _track(client: Client, path: str, robot: str) -> Track:
    answer = client.request("GET", f"{path}/robots/{quote(robot, safe='')}/trajectory?frame=map")
    poses = answer["poses"]
    return Track(
        robot=robot,
        pose=np.array([[p["x"], p["y"], p["theta"]] for p in poses]).reshape(-1, 3),
        submap=np.array([p["submap"] for p in poses], dtype=np.int64),
    )
