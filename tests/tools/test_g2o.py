"""g2o files: read as measurements, written from a map, and read again."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
import pytest
from numpy.typing import NDArray

from service.client import Client
from service.datasets import Dataset, DatasetError, read_source
from service.datasets.g2o import CLOSINGS, parse_g2o
from service.exporters.g2o import as_g2o, read_graph
from service.replaying import replay
from service.standalone import own_service
from submaps.batch import optimum
from submaps.config import MotionConfig, ObservationConfig
from submaps.geometry import so3
from submaps.geometry.se2 import between, compose, inverse
from submaps.geometry.space import SOLID, Pose
from submaps.simulation import circle, drive

Floats = NDArray[np.float64]

GRAPH = [
    "VERTEX_SE2 0 0 0 0",
    "VERTEX_SE2 3 1 0 0.1",
    "VERTEX_SE2 7 2 0 0.3",
    "VERTEX_XY 9 4 1",
    "FIX 0",
    "EDGE_SE2 0 3 1.0 0 0.1 100 0 0 100 0 400",
    "EDGE_SE2 3 7 1.0 0 0.2 100 0 0 100 0 400",
    "EDGE_SE2 7 0 -2 0 -0.3 1 0 0 1 0 1",
    "EDGE_SE2_XY 7 9 2 1 4 0 4",
    "EDGE_SE2_XY 0 9 4 1 4 0 4",
]


def parse(lines: list[str]) -> Dataset:
    return parse_g2o(lines, name="graph", source="graph.g2o")


def test_poses_in_the_order_of_their_ids_are_the_steps() -> None:
    run = parse(GRAPH)
    assert run.columns.t.tolist() == [0.0, 1.0, 2.0]
    assert run.columns.control_step.tolist() == [1, 2]
    assert run.columns.control.tolist() == [[1.0, 1.0], [0.0, 0.0], [0.1, 0.2]]
    assert run.columns.observation_step.tolist() == [0, 2]
    assert run.columns.landmark == ("9", "9")
    assert run.columns.z.tolist() == [[4.0, 2.0], [1.0, 1.0]]
    assert run.observation.sigma == (0.5, 0.5)
    assert run.columns.observation_covariance is None


def test_an_edge_between_others_is_no_measurement_and_is_counted() -> None:
    again = [*GRAPH, "EDGE_SE2 0 3 1.1 0 0.1 100 0 0 100 0 400"]
    assert parse(again).notes == {CLOSINGS: 2}
    assert parse(again).columns.control[0, 0] == 1.0
    assert parse([line for line in GRAPH if not line.startswith("EDGE_SE2 7")]).notes == {}


def test_the_noise_of_an_edge_stands_in_the_axes_of_its_later_pose() -> None:
    """g2o's error of a small (dx, dy, dtheta) of the increment, to first order, against its information."""
    information = np.array([[90.0, 5.0, 1.0], [5.0, 40.0, 2.0], [1.0, 2.0, 300.0]])
    triangle = " ".join(str(value) for value in information[np.triu_indices(3)])
    run = parse([f"EDGE_SE2 0 1 2.0 0.5 0.8 {triangle}", "EDGE_SE2_XY 1 5 1 1 4 1 5"])
    assert run.columns.control_covariance is not None
    edge, h = (2.0, 0.5, 0.8), 1e-6
    by = np.empty((3, 3))
    for axis in range(3):
        moved = np.array(edge) + h * np.eye(3)[axis]
        by[:, axis] = np.array(between(edge, (float(moved[0]), float(moved[1]), float(moved[2])))) / h
    np.testing.assert_allclose(np.linalg.inv(run.columns.control_covariance[0]), by.T @ information @ by, rtol=1e-4)
    assert run.columns.observation_covariance is not None
    np.testing.assert_allclose(np.linalg.inv(run.columns.observation_covariance[0]), [[4.0, 1.0], [1.0, 5.0]])


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("EDGE_SE2 7 8 1 0 0 1 0 0 1 0", "graph.g2o:11: EDGE_SE2 takes 12 fields"),
        ("EDGE_SE2_XY 7 9 1 0 1 0 1 9", "graph.g2o:11: EDGE_SE2_XY takes 8 fields"),
        ("VERTEX_SE2 7 0 0", "graph.g2o:11: VERTEX_SE2 takes 5 fields"),
        ("EDGE_SE2 7 x 1 0 0 1 0 0 1 0 1", "graph.g2o:11: expected a pose id, got 'x'"),
        ("EDGE_SE2_XY 7 9 1 inf 1 0 1", "graph.g2o:11: expected a finite number, got 'inf'"),
        ("EDGE_SE2_XY 7 9 1 1 1 2 1", "graph.g2o:11: the noise is no positive definite information"),
        ("VERTEX_SE3:QUAT 7 0 0 0 0 0 0 1", "graph.g2o:11: expected one of VERTEX_SE2"),
        ("VERTEX_SE2 8 0 0 0", "graph.g2o: expected an EDGE_SE2 from pose 7 to 8, the next one, found none"),
    ],
)
def test_a_broken_line_is_named(line: str, says: str) -> None:
    with pytest.raises(DatasetError) as caught:
        parse([*GRAPH, line])
    assert str(caught.value).startswith(says)


def test_a_graph_of_poses_alone_has_nothing_to_map(tmp_path: Path) -> None:
    path = tmp_path / "poses.txt"
    path.write_text("\n".join(["# poses", *GRAPH[:8]]))
    with pytest.raises(DatasetError, match=r"holds no landmarks \(no line EDGE_SE2_XY\)"):
        read_source(str(path))


@pytest.mark.parametrize("name", ["intel", "manhattanOlson3500"])
def test_real_pose_graphs_are_recognised_and_refused(data_dir: Path, name: str) -> None:
    with pytest.raises(DatasetError, match="holds no landmarks"):
        read_source(str(data_dir / "pose_graphs" / f"{name}.g2o"))


def words(values: Floats) -> str:
    return " ".join(repr(float(value)) for value in values)


def test_a_run_written_as_g2o_has_the_optimum_that_it_had(data_dir: Path, tmp_path: Path) -> None:
    run, steps = read_source(str(data_dir / "isam" / "victoriaPark.txt")), 600
    first = next(batch for _, batch in run.batches(10**6, steps))
    path = tmp_path / "trees.g2o"
    with path.open("w") as out:
        for k, move in enumerate(first.control.T):
            c, s = np.cos(move[2]), np.sin(move[2])
            by = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])  # into the axes of the later pose
            information = np.linalg.inv(by @ np.diag(np.square(run.motion.sigma)) @ by.T)
            out.write(f"EDGE_SE2 {k} {k + 1} {words(move)} {words(information[np.triu_indices(3)])}\n")
        weight = 1.0 / run.observation.sigma[0] ** 2
        for step, mark, z in zip(first.observation_step.tolist(), first.landmark, first.z.T, strict=True):
            out.write(f"EDGE_SE2_XY {step} {mark} {words(z)} {weight!r} 0 {weight!r}\n")
    again = read_source(str(path))
    one, two = (optimum(batch, run.motion, run.observation) for batch in (first, again.columns))
    assert two.ids == one.ids
    assert two.chi2 == pytest.approx(one.chi2, rel=1e-9)
    np.testing.assert_allclose(two.landmarks, one.landmarks, atol=1e-6)


# -- a map as g2o --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def graph() -> Iterator[nx.DiGraph]:
    """What the service says of a simulated round."""
    run = drive(circle(laps=1.1), np.random.default_rng(4))
    noise = ObservationConfig("cartesian", (0.25, 0.25))
    source = Dataset.single("round", MotionConfig("velocity", (0.05, float(np.deg2rad(5.0)))), noise, run.batch)
    with own_service() as url, Client(url) as client:
        replay(client, source, "round", lambda *_: None)
        yield read_graph(client, "round")


def of_kind(graph: nx.DiGraph, kind: str) -> list[tuple[str, int | str]]:
    return [node for node in graph if node[0] == kind]


def test_the_graph_holds_every_sub_map_and_landmark_once(graph: nx.DiGraph) -> None:
    submaps, landmarks = of_kind(graph, "submap"), of_kind(graph, "landmark")
    assert len(submaps) > 5
    assert len(landmarks) == 20
    for k, (before, after) in enumerate(itertools.pairwise(submaps)):
        assert (before[1], after[1]) == (k, k + 1)
        assert graph.has_edge(before, after)
    assert nx.is_weakly_connected(graph)


def test_edges_agree_with_the_vertices_that_they_tie(graph: nx.DiGraph) -> None:
    """Far inside what is known: within 4 standard deviations of the edge, and of the map as a whole."""
    for a, b, edge in graph.edges(data=True):
        pose, z = graph.nodes[a]["pose"], edge["z"]
        there = graph.nodes[b]["pose"] if b[0] == "submap" else (*graph.nodes[b]["point"], 0.0)
        error = np.array(between(compose(pose, z if len(z) == 3 else (*z, 0.0)), there))[: len(z)]
        sigma = float(np.sqrt(np.linalg.eigvalsh(np.array(edge["covariance"]))[-1]))
        assert np.abs(error[:2]).max() < 4.0 * sigma + 0.05


def test_what_is_written_is_read_again(graph: nx.DiGraph, tmp_path: Path) -> None:
    path = tmp_path / "round.g2o"
    path.write_text("".join(as_g2o(graph)))
    run = read_source(str(path))
    submaps = of_kind(graph, "submap")
    assert run.columns.steps == len(submaps)
    assert run.notes == {}
    ties = [(a, b, edge) for a, b, edge in graph.edges(data=True) if b[0] == "landmark"]
    exits = [(a, b, edge) for a, b, edge in graph.edges(data=True) if b[0] == "submap"]
    assert run.columns.observations == len(ties)
    assert len(set(run.columns.landmark)) == 20
    np.testing.assert_array_equal(run.columns.control.T, [edge["z"] for _, _, edge in exits])
    assert run.columns.control_covariance is not None
    for found, (_, _, edge) in zip(run.columns.control_covariance, exits, strict=True):
        np.testing.assert_allclose(found, edge["covariance"], rtol=1e-6, atol=1e-12)
    found = optimum(run.columns, run.motion, run.observation)
    origin = inverse(graph.nodes[submaps[0]]["pose"])
    marks = np.array([compose(origin, (*graph.nodes[node]["point"], 0.0))[:2] for node in of_kind(graph, "landmark")])
    names = {str(len(submaps) + j): mark for j, mark in enumerate(marks)}
    distance = found.landmarks - np.array([names[name] for name in found.ids])
    assert float(np.sqrt(np.mean(np.sum(distance**2, axis=1)))) < 0.3


def test_comments_say_the_names_of_the_landmarks(graph: nx.DiGraph) -> None:
    lines = list(as_g2o(graph))
    named = [line.split()[1:] for line in lines if line.startswith("#")]
    assert {name for _, _, name in named} == {str(k) for k in range(20)}
    assert [line for line in lines if line.startswith("FIX")] == ["FIX 0\n"]


# -- in space ------------------------------------------------------------------------------------

SQUARE_ROOT = np.random.default_rng(6).normal(size=(6, 6))
FRAMES: list[Pose] = [SOLID.origin, (1.0, 2.0, 0.5, 0.3, -0.8, 1.4)]
SPREAD = SQUARE_ROOT @ SQUARE_ROOT.T
SPACE_EDGE: dict[str, Any] = {"z": (1.1, 1.9, 0.4, 0.25, -0.85, 1.45), "covariance": SPREAD.tolist()}
SEEN_EDGE: dict[str, Any] = {"z": (0.5, -0.25, 2.0), "covariance": [[0.5, 0.1, 0], [0.1, 0.4, 0], [0, 0, 0.25]]}


@pytest.fixture(scope="module")
def in_space() -> nx.DiGraph:
    """Two frames and a landmark."""
    graph = nx.DiGraph()
    for k, pose in enumerate(FRAMES):
        graph.add_node(("submap", k), pose=pose)
    graph.add_node(("landmark", "oak"), point=(0.5, -0.2, 2.1))
    graph.add_edge(("submap", 0), ("submap", 1), **SPACE_EDGE)
    graph.add_edge(("submap", 0), ("landmark", "oak"), **SEEN_EDGE)
    return graph


def numbers_after(lines: list[str], tag: str, ids: int) -> Floats:
    (line,) = (line.split() for line in lines if line.startswith(f"{tag} "))
    return np.array([float(word) for word in line[1 + ids :]])


def symmetric(triangle: Floats, size: int) -> Floats:
    upper = np.zeros((size, size))
    upper[np.triu_indices(size)] = triangle
    whole: Floats = upper + np.triu(upper, 1).T
    return whole


def test_a_map_in_space_has_the_tags_of_space(in_space: nx.DiGraph) -> None:
    lines = list(as_g2o(in_space))
    tags = [line.split()[0] for line in lines]
    assert tags == [
        "PARAMS_SE3OFFSET", "VERTEX_SE3:QUAT", "VERTEX_SE3:QUAT", "FIX", "#", "VERTEX_TRACKXYZ", "EDGE_SE3:QUAT",
        "EDGE_SE3_TRACKXYZ",
    ]  # fmt: skip
    assert lines[0].split()[1:] == ["0", *"000", *"0001"]
    vertex = np.array([float(word) for word in lines[2].split()[2:]])
    np.testing.assert_allclose(vertex[:3], FRAMES[1][:3])
    np.testing.assert_allclose(vertex[3:], so3.quaternion(*FRAMES[1][3:]))
    # The vertex, the landmark, and the offset that is none.
    assert lines[-1].split()[1:4] == ["0", "2", "0"]
    seen = numbers_after(lines, "EDGE_SE3_TRACKXYZ", 3)
    np.testing.assert_allclose(seen[:3], SEEN_EDGE["z"])
    np.testing.assert_allclose(symmetric(seen[3:], 3) @ SEEN_EDGE["covariance"], np.eye(3), atol=1e-12)


def test_the_information_in_space_is_that_of_g2os_own_error(in_space: nx.DiGraph) -> None:
    """Its error is the translation and the quaternion's vector part of Z^-1 X, here by differences."""
    line, h = numbers_after(list(as_g2o(in_space)), "EDGE_SE3:QUAT", 2), 1e-6
    z = SOLID.as_pose(np.array(SPACE_EDGE["z"]))
    np.testing.assert_allclose(line[3:7], so3.quaternion(*z[3:]))
    by = np.empty((6, 6))
    for axis, e in enumerate(h * np.eye(6)):
        turned = SOLID.compose((0.0, 0.0, 0.0, *e[3:].tolist()), (0.0, 0.0, 0.0, *z[3:]))
        delta = SOLID.between(z, (*np.add(z[:3], e[:3]).tolist(), *turned[3:]))
        by[:, axis] = np.array([*delta[:3], *so3.quaternion(*delta[3:])[:3]]) / h
    expected = np.linalg.inv(by @ np.array(SPACE_EDGE["covariance"]) @ by.T)
    scale = np.sqrt(np.outer(np.diagonal(expected), np.diagonal(expected)))
    np.testing.assert_allclose(symmetric(line[7:], 6) / scale, expected / scale, atol=1e-5)
