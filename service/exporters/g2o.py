"""A map in g2o's text format: sub-map frames and landmarks, tied by what the sub-maps say of them.

Each sub-map in ``map`` is a VERTEX_SE2 with its number for an id, each landmark a VERTEX_XY. Where a
robot leaves a sub-map an EDGE_SE2 leads to its next, and an EDGE_SE2_XY to each landmark that a sub-map
holds; informations are inverse covariances. A landmark that several sub-maps hold is what ties them
together, so the graph's ties, which are made of such landmarks, are left out: they would count twice. The
graph is an approximation: within a sub-map the exit and the landmarks are correlated, in it they are not.

The error of an EDGE_SE2 stands in the axes of the later vertex, so a covariance is turned back by
the edge's angle (see ``service.datasets.g2o``).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from service.client import Client, path_of

Floats = NDArray[np.float64]


def read_graph(client: Client, map_: str) -> nx.DiGraph:
    """The sub-maps and landmarks of a map that have a place in ``map``, and what ties them.

    Nodes are ("submap", k) with a ``pose`` (x m, y m, theta rad) and ("landmark", id) with a ``point``
    (m); edges go from a sub-map, with ``z`` in its frame and the ``covariance`` of its additive errors.
    """
    path, graph = path_of(map_), nx.DiGraph()
    submaps = [one for one in client.pages(f"{path}/submaps", "submaps") if one["pose"] is not None]
    for one in submaps:
        graph.add_node(("submap", one["id"]), pose=_pose(one["pose"]))
    for one in client.landmarks(map_):
        graph.add_node(("landmark", one["id"]), point=(one["x"], one["y"]))
    before: dict[str, dict[str, Any]] = {}  # by robot, the end of the sub-map that it was in before
    for one in submaps:
        if one["robot"] in before:
            left = before[one["robot"]]
            edge = {"z": _pose(left["robot_pose"]), "covariance": left["robot_pose"]["covariance"]}
            graph.add_edge(("submap", left["id"]), ("submap", one["id"]), **edge)
        before[one["robot"]] = submap = client.request("GET", f"{path}/submaps/{one['id']}")
        _add_landmarks(graph, submap)
    return graph


def _add_landmarks(graph: nx.DiGraph, submap: dict[str, Any]) -> None:
    for one in submap["local_landmarks"]:
        if ("landmark", one["id"]) in graph and one["id"] not in submap["untied"]:
            edge = {"z": (one["x"], one["y"]), "covariance": one["covariance"]}
            graph.add_edge(("submap", submap["id"]), ("landmark", one["id"]), **edge)


def _pose(answer: dict[str, float]) -> tuple[float, float, float]:
    return answer["x"], answer["y"], answer["theta"]


def as_g2o(graph: nx.DiGraph) -> Iterator[str]:
    """Lines of the format; a comment before each landmark says its name."""
    submaps = [node for node in graph if node[0] == "submap"]
    landmarks = [node for node in graph if node[0] == "landmark"]
    number = {node: node[1] for node in submaps}
    after = max(number.values(), default=-1) + 1
    number |= {node: after + j for j, node in enumerate(landmarks)}
    for node in submaps:
        yield _line("VERTEX_SE2", number[node], *graph.nodes[node]["pose"])
    if submaps:
        yield _line("FIX", number[submaps[0]])
    for node in landmarks:
        yield f"# {number[node]} is {node[1]}\n"
        yield _line("VERTEX_XY", number[node], *graph.nodes[node]["point"])
    for a, b, edge in graph.edges(data=True):
        covariance = np.array(edge["covariance"])
        if b[0] == "submap":
            triangle = _information(_turned(covariance, -edge["z"][2]))
            yield _line("EDGE_SE2", number[a], number[b], *edge["z"], *triangle)
        else:
            yield _line("EDGE_SE2_XY", number[a], number[b], *edge["z"], *_information(covariance))


def _turned(covariance: Floats, angle: float) -> Floats:
    """The covariance (3, 3) along axes turned by minus an angle (rad)."""
    A = np.eye(3)
    A[:2, :2] = (np.cos(angle), -np.sin(angle)), (np.sin(angle), np.cos(angle))
    return np.asarray(A @ covariance @ A.T)


def _information(covariance: Floats) -> list[float]:
    """The upper triangle of the inverse, row by row."""
    inverse = np.linalg.inv(covariance)
    inverse = 0.5 * (inverse + inverse.T)
    triangle: list[float] = inverse[np.triu_indices(len(inverse))].tolist()
    return triangle


def _line(kind: str, *values: float) -> str:
    return " ".join([kind, *(repr(value) for value in values)]) + "\n"
