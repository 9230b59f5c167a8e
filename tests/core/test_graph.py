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
from submaps.geometry.space import SOLID, Space
from submaps.submap import Submap
from tests.core.atlases import additive, apart, atlas, both_filters, both_spaces, chain, moved, outside, slopes, submap

Floats = NDArray[np.float64]


@both_spaces
@both_filters
def test_an_exit_is_the_end_pose_with_its_additive_covariance(space: Space, invariant: bool) -> None:
    held = chain([[0], [1], [2]], space, seed=1, invariant=invariant)
    edge = Graph(atlas(held)).edge("exit", 0, 1)
    assert (edge.kind, edge.a, edge.b, edge.transform) == ("exit", 0, 1, held[0].pose)
    p = space.pose
    assert np.allclose(edge.covariance, additive(held[0])[:p, :p], rtol=1e-8, atol=1e-13)


@both_spaces
@both_filters
def test_a_tie_is_weighted_least_squares_on_the_common_landmarks(space: Space, invariant: bool) -> None:
    held = chain([[0, 1, 2, 3], [9], [3, 1, 2, 8]], space, seed=2, invariant=invariant)
    edge = Graph(atlas(held)).edge("tie", 0, 2)
    a, b = held[0], held[2]
    common, d = [1, 2, 3], space.dim
    rows_a = [a.slot_of(i) + k for i in common for k in range(d)]
    rows_b = [b.slot_of(i) + k for i in common for k in range(d)]
    cov_a, cov_b = additive(a)[np.ix_(rows_a, rows_a)], additive(b)[np.ix_(rows_b, rows_b)]
    A, B = a.mean[rows_a].reshape(-1, d), b.mean[rows_b].reshape(-1, d)
    T = np.array(edge.transform)

    def left(e: Floats) -> Floats:
        return (A - outside(space, moved(space, T, e), B)).ravel()

    turn = np.kron(np.eye(3), space.rotation(T))
    C = cov_a + turn @ cov_b @ turn.T
    J = slopes(left, space.pose)
    gradient = J.T @ np.linalg.solve(C, left(np.zeros(space.pose)))
    information = J.T @ np.linalg.solve(C, J)
    assert np.abs(np.linalg.solve(information, gradient)).max() < 1e-9
    assert np.allclose(edge.covariance, np.linalg.inv(information), rtol=1e-6, atol=1e-12)


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


def test_in_space_a_tie_takes_three_landmarks() -> None:
    held = chain([[0, 1, 5], [1, 2], [3, 0, 1], [3, 0, 1]], SOLID)
    assert Graph(atlas(held)).pairs() == [("exit", 0, 1), ("exit", 1, 2), ("exit", 2, 3), ("tie", 2, 3)]


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


@both_spaces
@both_filters
@pytest.mark.parametrize("pair", [(0, 3), (1, 2), (0, 1)])
def test_there_and_back(space: Space, invariant: bool, pair: tuple[int, int]) -> None:
    """One path leads along a chain, so the two directions are inverse of each other."""
    view = View(atlas(chain([[0], [1], [2], [3]], space, seed=3, invariant=invariant)))
    there, covariance, path = view.transform(*pair)
    back, covariance_back, path_back = view.transform(*pair[::-1])
    assert path == path_back[::-1]
    assert space.compose(there, back) == pytest.approx(space.origin, abs=1e-12)
    assert np.allclose(covariance_back, space.inverse_covariance(there, covariance), rtol=1e-9, atol=1e-14)


@both_spaces
def test_from_a_submap_to_itself(space: Space) -> None:
    T, covariance, path = View(atlas(chain([[0], [1]], space))).transform(1, 1)
    assert (T, path) == (space.origin, [1])
    assert covariance.shape == (space.pose, space.pose)
    assert not covariance.any()


@both_spaces
def test_a_tie_agrees_with_the_exits_it_closes(space: Space) -> None:
    """On a drive with hardly any noise every path says the same."""
    held = chain([[0, 1, 2], [2, 3], [3, 4], [4, 0, 1, 2]], space, sigma=1e-7, seed=4)
    graph = Graph(atlas(held))
    along = space.origin
    for s in held[:3]:
        along = space.compose(along, s.pose)
    tie = graph.edge("tie", 0, 3).transform
    assert space.compose(space.inverse(along), tie) == pytest.approx(space.origin, abs=1e-5)


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


@both_spaces
@both_filters
def test_a_landmark_in_another_frame(space: Space, invariant: bool) -> None:
    """By path: transformed with the frame's error, as independent as Bosse's graph has it."""
    held = chain([[0], [1], [2]], space, seed=6, invariant=invariant)
    view, d, p = View(atlas(held)), space.dim, space.pose
    own = held[1].mean[p : p + d]
    T, by_frame, _ = view.transform(0, 1)
    J = slopes(lambda e: outside(space, moved(space, np.array(T), e[:p]), own + e[p:]), p + d)
    cov = additive(held[1])[p:, p:]
    found = view.landmark("L1", "submap/0")
    assert found.position == pytest.approx(outside(space, np.array(T), own))
    expected = J[:, :p] @ by_frame @ J[:, :p].T + J[:, p:] @ cov @ J[:, p:].T
    assert np.allclose(found.covariance, expected, rtol=1e-7, atol=1e-12)
    here = view.landmark("L1", "submap/1")
    assert np.allclose(here.covariance, cov, rtol=1e-8, atol=1e-13)


@both_spaces
def test_a_tie_about_one_place_leaves_the_rotation_open(space: Space) -> None:
    """Landmarks at one place in either sub-map tell where they lie, and not how they are turned."""
    d, p, common = space.dim, space.pose, list(range(space.dim))
    one, two, *_ = chain([common, common, [0]], space, seed=3)
    mean_a, mean_b = one.mean.copy(), two.mean.copy()
    mean_a[p:], mean_b[p:] = np.tile(mean_a[p : p + d], d), 0.0
    P = two.covariance() * 1e-9
    still = submap(1, common, mean_b, P, following=2)
    edge = Graph(atlas([submap(0, common, mean_a, one.covariance(), following=1), still])).edge("tie", 0, 1)
    assert edge.transform[:d] == pytest.approx(tuple(mean_a[p : p + d]), abs=0.2)
    assert np.diag(edge.covariance)[d:].min() > 1.0
    assert np.all(np.linalg.eigvalsh(edge.covariance) > 0.0)


@pytest.mark.parametrize(("off_line", "sure"), [(0.0, False), (0.1, False), (1.0, True)])
def test_landmarks_on_a_line_leave_the_rotation_about_it_open(off_line: float, sure: bool) -> None:
    """Noise of 0.1 m about a line looks like a lever, and is none."""
    rng = np.random.default_rng(1)
    points = np.array([[2.0, 0.0, 0.0], [4.0, off_line, 0.0], [7.0, 0.0, 0.0], [9.0, 0.0, 0.0]])
    held = []
    for k in range(2):
        noisy = points + 0.1 * rng.normal(size=points.shape)
        mean, P = np.concatenate([np.zeros(6), noisy.ravel()]), 0.01 * np.eye(18)
        held.append(submap(k, [0, 1, 2, 3], mean, P, following=-1 if k else 1, invariant=False))
    edge = Graph(atlas(held)).edge("tie", 0, 1)
    assert (np.linalg.eigvalsh(edge.covariance[3:, 3:])[-1] < 1.0 / 9.0) == sure
    if sure:
        assert np.abs(edge.transform).max() < 0.4


@both_spaces
def test_the_fewest_landmarks_that_tie_may_lie_any_way_round(space: Space) -> None:
    """The start in closed form finds half turns as well: at hardly any noise the transform is exact."""
    rng, d = np.random.default_rng(5), space.dim
    for _ in range(30):
        T = np.concatenate([rng.normal(size=d), rng.normal(size=space.rot)])
        T[d:] *= rng.uniform(0.9, 1.0) * np.pi / np.linalg.norm(T[d:])
        far, near = 3.0 * rng.normal(size=(d, d)), np.empty((d, d))
        near[:] = outside(space, T, far)
        P = np.diag([1e-2] * space.pose + [1e-12] * d * d)
        held = []
        for k, at in enumerate((near, far)):
            mean = np.concatenate([np.zeros(space.pose), at.ravel()])
            held.append(submap(k, list(range(d)), mean, P, following=-1 if k else 1, invariant=False))
        found = Graph(atlas(held)).edge("tie", 0, 1).transform
        assert np.abs(apart(space, np.array(found), T)).max() < 1e-5
