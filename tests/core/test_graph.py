"""The graph of relative transforms: edges in closed form, the surest path, both directions."""

from __future__ import annotations

import math
from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
from numpy.typing import NDArray

from submaps.atlas.graph import Graph
from submaps.atlas.view import View
from submaps.errors import NotConnected, UnknownName
from submaps.geometry.se2 import Pose, compose, inverse, inverse_covariance
from submaps.submap import Submap
from tests.core.support import R, atlas, chain, jacobian, minus, plus, submap

Floats = NDArray[np.float64]
both_filters = pytest.mark.parametrize("invariant", [True, False], ids=["invariant", "standard"])


def additive(s: Submap) -> Floats:
    """Covariance of a sub-map's additive errors, by numeric Jacobian from its definition."""
    J = jacobian(lambda xi: plus(s.mean, xi, s.invariant) - s.mean, np.zeros(s.mean.shape[0]))
    whole: Floats = J @ s.covariance() @ J.T
    return whole


@both_filters
def test_an_exit_is_the_end_pose_with_its_additive_covariance(invariant: bool) -> None:
    held = chain([[0], [1], [2]], seed=1, invariant=invariant)
    edge = Graph(atlas(held)).edge("exit", 0, 1)
    assert (edge.kind, edge.a, edge.b, edge.transform) == ("exit", 0, 1, held[0].pose)
    assert np.allclose(edge.covariance, additive(held[0])[:3, :3], rtol=1e-8, atol=1e-14)


@both_filters
def test_a_tie_is_weighted_least_squares_on_the_common_landmarks(invariant: bool) -> None:
    held = chain([[0, 1, 2, 3], [9], [3, 1, 2, 8]], seed=2, invariant=invariant)
    edge = Graph(atlas(held)).edge("tie", 0, 2)
    a, b = held[0], held[2]
    common = [1, 2, 3]
    rows_a = [a.slot_of(i) + k for i in common for k in (0, 1)]
    rows_b = [b.slot_of(i) + k for i in common for k in (0, 1)]
    cov_a, cov_b = additive(a)[np.ix_(rows_a, rows_a)], additive(b)[np.ix_(rows_b, rows_b)]
    A, B = a.mean[rows_a].reshape(-1, 2), b.mean[rows_b].reshape(-1, 2)
    T = np.array(edge.transform)

    def left(v: Floats) -> Floats:
        return (A - v[:2] - B @ R(v[2]).T).ravel()

    turn = np.kron(np.eye(3), R(T[2]))
    C = cov_a + turn @ cov_b @ turn.T
    J = jacobian(left, T, 1e-3)
    gradient = J.T @ np.linalg.solve(C, left(T))
    information = J.T @ np.linalg.solve(C, J)
    assert np.abs(np.linalg.solve(information, gradient)).max() < 1e-9
    assert np.allclose(edge.covariance, np.linalg.inv(information), rtol=1e-6)


def test_a_tie_of_two_landmarks_by_hand() -> None:
    """Equal isotropic noise s on both sides: position s^2 (2 of 2 points), heading 2 s^2 / sum d^2."""
    s = 0.01
    one = submap(0, [0, 1], np.array([9.0, 0, 0, -2, 0, 2, 0]), np.eye(7) * s**2, following=1, invariant=False)
    two = submap(1, [0, 1], np.array([0.0, 0, 0, 0, 2, 0, -2]), np.eye(7) * s**2, invariant=False)
    edge = Graph(atlas([one, two])).edge("tie", 0, 1)
    assert edge.transform == pytest.approx((0.0, 0.0, 0.5 * math.pi), abs=1e-12)
    assert np.allclose(edge.covariance, np.diag([s**2, s**2, 2 * s**2 / 8.0]), atol=1e-12)


def test_which_edges_there_are() -> None:
    held = chain([[0, 1, 5], [1, 2], [3, 0, 1], [3, 0, 4]])
    graph = Graph(atlas(held))
    expected = [
        ("exit", 0, 1), ("exit", 1, 2), ("tie", 0, 2), ("exit", 2, 3), ("tie", 2, 3),
    ]  # fmt: skip
    assert graph.pairs() == expected
    assert View(atlas(held)).counts()["edges"] == 5
    for k in range(4):
        assert sorted(graph.neighbours(k)) == sorted(p for p in expected if k in p[1:])


def test_a_graph_that_grows_keeps_its_order() -> None:
    held = chain([[0, 1, 5], [1, 2], [3, 0, 1], [3, 0, 4], [5, 0, 1]])
    whole = Graph(atlas(held)).pairs()
    for count in range(1, 5):
        part = [*held[: count - 1], replace(held[count - 1], following=-1)]
        pairs = Graph(atlas(part)).pairs()
        assert pairs == whole[: len(pairs)]


def corridor(sure_tie: bool) -> list[Submap]:
    """Four sub-maps 1 m apart; the first and the last hold two landmarks in common."""
    noise = 1e-4 if sure_tie else 1.0
    held = []
    for k in range(4):
        marks = [0, 1] if k in (0, 3) else []
        P = np.diag([0.01, 0.01, 1e-4, *[noise] * (2 * len(marks))])
        points = np.array([5.0, 5.0, 5.0, -5.0]) - np.array([float(k), 0.0] * 2)
        mean = np.concatenate([[1.0, 0.0, 0.0], points[: 2 * len(marks)]])
        held.append(submap(k, marks, mean, P, following=k + 1 if k < 3 else -1, invariant=False))
    return held


@pytest.mark.parametrize(("sure", "expected"), [(True, [0, 3]), (False, [0, 1, 2, 3])])
def test_the_surest_path_is_taken(sure: bool, expected: list[int]) -> None:
    graph = Graph(atlas(corridor(sure)))
    there, covariance, path = graph.path(0, 3)
    assert path == expected
    assert there == pytest.approx((3.0, 0.0, 0.0), abs=1e-9)
    if sure:
        assert np.array_equal(covariance, graph.edge("tie", 0, 3).covariance)
    else:  # three exits of 0.01 m^2 and 1e-4 rad^2; a turn at the first moves the end by 2 m
        assert np.allclose(np.diag(covariance), [0.03, 0.03 + 1e-4 * (4 + 1), 3e-4], rtol=1e-9)
    assert nx.shortest_path_length(graph.as_networkx(), 0, 3) == 1


@both_filters
@pytest.mark.parametrize("pair", [(0, 3), (1, 2), (0, 1)])
def test_there_and_back(invariant: bool, pair: tuple[int, int]) -> None:
    """One path leads along a chain, so the two directions are inverse of each other."""
    view = View(atlas(chain([[0], [1], [2], [3]], seed=3, invariant=invariant)))
    there, covariance, path = view.transform(*pair)
    back, covariance_back, path_back = view.transform(*pair[::-1])
    assert path == path_back[::-1]
    assert compose(there, back) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
    assert np.allclose(covariance_back, inverse_covariance(there, covariance), rtol=1e-9, atol=1e-15)


def test_from_a_submap_to_itself() -> None:
    T, covariance, path = View(atlas(chain([[0], [1]]))).transform(1, 1)
    assert (T, path) == ((0.0, 0.0, 0.0), [1])
    assert not covariance.any()


def test_a_tie_agrees_with_the_exits_it_closes() -> None:
    """On a drive with hardly any noise every path says the same."""
    held = chain([[0, 1, 2], [2, 3], [3, 4], [4, 0, 1]], sigma=1e-7, seed=4)
    graph = Graph(atlas(held))
    along: Pose = (0.0, 0.0, 0.0)
    for s in held[:3]:
        along = compose(along, s.pose)
    tie = graph.edge("tie", 0, 3).transform
    assert compose(inverse(along), tie) == pytest.approx((0.0, 0.0, 0.0), abs=1e-5)


def test_what_is_not_connected() -> None:
    mine = chain([[0, 1], [0, 1]])
    theirs = replace(chain([[0, 1]])[0], number=2, robot=1, previous=-1)
    graph = Graph(atlas([*mine, theirs]))
    with pytest.raises(NotConnected):
        graph.path(0, 2)
    with pytest.raises(UnknownName):
        graph.path(0, 3)
    assert ("tie", 0, 2) not in graph.pairs()


def test_as_networkx() -> None:
    held = chain([[0, 1, 5], [1, 2], [3, 0, 1], [3, 0, 4]])
    graph = Graph(atlas(held))
    out = graph.as_networkx()
    assert sorted(out.nodes) == [0, 1, 2, 3]
    assert sorted((d["kind"], min(a, b), max(a, b)) for a, b, d in out.edges(data=True)) == sorted(graph.pairs())
    data = out.get_edge_data(0, 2)["tie"]
    assert data["transform"] == graph.edge("tie", 0, 2).transform
    assert np.array_equal(data["covariance"], graph.edge("tie", 0, 2).covariance)
    assert nx.is_connected(out)


@both_filters
def test_a_landmark_in_another_frame(invariant: bool) -> None:
    """By path: transformed with the frame's error, as independent as Bosse's graph has it."""
    held = chain([[0], [1], [2]], seed=6, invariant=invariant)
    view = View(atlas(held))
    own = held[1].mean[3:5]
    T, by_frame, _ = view.transform(0, 1)
    J = jacobian(lambda v: v[:2] + R(v[2]) @ v[3:], np.array([*T, *own]))
    cov = additive(held[1])[3:, 3:]
    found = view.landmark("L1", "submap/0")
    assert (found.x, found.y) == pytest.approx(tuple(np.array(T[:2]) + R(T[2]) @ own))
    assert np.allclose(found.covariance, J[:, :3] @ by_frame @ J[:, :3].T + J[:, 3:] @ cov @ J[:, 3:].T, rtol=1e-7)
    here = view.landmark("L1", "submap/1")
    assert np.allclose(here.covariance, cov, rtol=1e-8)
    assert minus(held[1].mean, held[1].mean, invariant).max() == 0.0


def test_a_tie_about_one_place_leaves_the_heading_open() -> None:
    """Two landmarks at one place in either sub-map tell where they lie, and not how they are turned."""
    one, two, *_ = chain([[0, 1], [0, 1], [0]], seed=3)
    mean_a, mean_b = one.mean.copy(), two.mean.copy()
    mean_a[5:7], mean_b[3:7] = mean_a[3:5], 0.0
    P = two.covariance() * 1e-9
    still = submap(1, [0, 1], mean_b, P, following=2)
    edge = Graph(atlas([submap(0, [0, 1], mean_a, one.covariance(), following=1), still])).edge("tie", 0, 1)
    assert edge.transform[:2] == pytest.approx(tuple(mean_a[3:5]), abs=0.2)
    assert edge.covariance[2, 2] > 1.0
    assert np.all(np.linalg.eigvalsh(edge.covariance) > 0.0)
