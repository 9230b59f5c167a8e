"""A map in g2o's text format: sub-map frames and landmarks, tied by what the sub-maps say of them.

Each sub-map in ``map`` is a VERTEX_SE2 with its number for an id, each landmark a VERTEX_XY. Where a
robot leaves a sub-map an EDGE_SE2 leads to its next, and an EDGE_SE2_XY to each landmark that a sub-map
holds; informations are inverse covariances. In space they are VERTEX_SE3:QUAT, VERTEX_TRACKXYZ, EDGE_SE3:QUAT
and EDGE_SE3_TRACKXYZ, the last by way of a PARAMS_SE3OFFSET that is no offset. A landmark that several sub-maps
hold is what ties them together, so the graph's ties, which are made of such landmarks, are left out: they would
count twice. The graph is an approximation: within a sub-map the exit and the landmarks are correlated, in it
they are not.

The error of an edge between poses stands in the axes of the later vertex, so a covariance is turned back by the
edge's rotation (see ``service.datasets.g2o``). In space g2o's error of a rotation is the vector part of its
quaternion, half of a small rotation vector (g2o, ``EdgeSE3::computeError``).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from service.client import Client, path_of
from service.wire.poses import point_of, pose_of
from submaps.geometry import so3
from submaps.geometry.space import PLANE, SOLID, Pose

Floats = NDArray[np.float64]


def read_graph(client: Client, map_: str) -> nx.DiGraph:
    """The sub-maps and landmarks of a map that have a place in ``map``, and what ties them.

    Nodes are ("submap", k) with a ``pose`` (x m, y m, theta rad; in space x, y, z m and a rotation vector,
    rad) and ("landmark", id) with a ``point`` (m); edges go from a sub-map, with ``z`` in its frame and the
    ``covariance`` of its additive errors.
    """
    path, graph = path_of(map_), nx.DiGraph()
    submaps = [one for one in client.pages(f"{path}/submaps", "submaps") if one["pose"] is not None]
    for one in submaps:
        graph.add_node(("submap", one["id"]), pose=pose_of(one["pose"]))
    for one in client.landmarks(map_):
        graph.add_node(("landmark", one["id"]), point=point_of(one))
    before: dict[str, dict[str, Any]] = {}  # by robot, the end of the sub-map that it was in before
    for one in submaps:
        if one["robot"] in before:
            left = before[one["robot"]]
            edge = {"z": pose_of(left["robot_pose"]), "covariance": left["robot_pose"]["covariance"]}
            graph.add_edge(("submap", left["id"]), ("submap", one["id"]), **edge)
        before[one["robot"]] = submap = client.request("GET", f"{path}/submaps/{one['id']}")
        _add_landmarks(graph, submap)
    return graph


def _add_landmarks(graph: nx.DiGraph, submap: dict[str, Any]) -> None:
    for one in submap["local_landmarks"]:
        if ("landmark", one["id"]) in graph and one["id"] not in submap["untied"]:
            edge = {"z": point_of(one), "covariance": one["covariance"]}
            graph.add_edge(("submap", submap["id"]), ("landmark", one["id"]), **edge)


@dataclass(frozen=True)
class _Tags:
    """What the format calls things, and what stands between an edge's ids and its numbers."""

    pose: str
    point: str
    exit: str
    sighting: str
    by: tuple[int, ...] = ()


_PLANE = _Tags("VERTEX_SE2", "VERTEX_XY", "EDGE_SE2", "EDGE_SE2_XY")
_SPACE = _Tags("VERTEX_SE3:QUAT", "VERTEX_TRACKXYZ", "EDGE_SE3:QUAT", "EDGE_SE3_TRACKXYZ", by=(0,))
_NO_OFFSET = "PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\n"


def as_g2o(graph: nx.DiGraph) -> Iterator[str]:
    """Lines of the format; a comment before each landmark says its name."""
    submaps = [node for node in graph if node[0] == "submap"]
    landmarks = [node for node in graph if node[0] == "landmark"]
    number = {node: node[1] for node in submaps}
    after = max(number.values(), default=-1) + 1
    number |= {node: after + j for j, node in enumerate(landmarks)}
    plane = all(len(graph.nodes[node]["pose"]) == PLANE.pose for node in submaps)
    tags = _PLANE if plane else _SPACE
    if not plane:
        yield _NO_OFFSET
    for node in submaps:
        yield _line(tags.pose, number[node], *_written(graph.nodes[node]["pose"]))
    if submaps:
        yield _line("FIX", number[submaps[0]])
    for node in landmarks:
        yield f"# {number[node]} is {node[1]}\n"
        yield _line(tags.point, number[node], *graph.nodes[node]["point"])
    for a, b, edge in graph.edges(data=True):
        covariance = np.array(edge["covariance"])
        if b[0] == "submap":
            triangle = _information(_of_edge(edge["z"], covariance))
            yield _line(tags.exit, number[a], number[b], *_written(edge["z"]), *triangle)
        else:
            yield _line(tags.sighting, number[a], number[b], *tags.by, *edge["z"], *_information(covariance))


def _written(pose: Pose) -> tuple[float, ...]:
    """A pose as the format has it: x y theta, or x y z qx qy qz qw."""
    return pose if len(pose) == PLANE.pose else (*pose[:3], *so3.quaternion(*pose[3:]))


def _of_edge(z: Pose, covariance: Floats) -> Floats:
    """The covariance of the format's error, from that of the additive errors of an edge ``z``."""
    A = np.eye(len(z))
    if len(z) == PLANE.pose:
        A[:2, :2] = PLANE.rotation(z).T
    else:
        A[:3, :3] = SOLID.rotation(z).T
        A[3:, 3:] = 0.5 * A[:3, :3]
    return np.asarray(A @ covariance @ A.T)


def _information(covariance: Floats) -> list[float]:
    """The upper triangle of the inverse, row by row."""
    inverse = np.linalg.inv(covariance)
    inverse = 0.5 * (inverse + inverse.T)
    triangle: list[float] = inverse[np.triu_indices(len(inverse))].tolist()
    return triangle


def _line(kind: str, *values: float) -> str:
    return " ".join([kind, *(repr(value) for value in values)]) + "\n"
