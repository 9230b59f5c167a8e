"""Pictures of a map."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
import pytest

from service.exporters.atlas import Atlas, Track
from service.exporters.picture import draw, ellipses
from submaps.trajectory import Trajectory


def test_an_ellipse_holds_the_points_at_its_mahalanobis_distance() -> None:
    turn = 0.4
    axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    covariance = axes @ np.diag([9.0, 1.0]) @ axes.T
    width, height, degrees = ellipses(covariance[None], 2.0)
    assert width[0] == pytest.approx(12.0)
    assert height[0] == pytest.approx(4.0)
    assert np.tan(np.radians(degrees[0])) == pytest.approx(np.tan(turn))
    tip = 0.5 * width[0] * np.array([np.cos(np.radians(degrees[0])), np.sin(np.radians(degrees[0]))])
    assert tip @ np.linalg.solve(covariance, tip) == pytest.approx(4.0)


@pytest.mark.parametrize(("poses", "robots"), [(0, 1), (1, 1), (30, 1), (30, 3), (700, 20)])
def test_maps_of_any_size_are_drawn(poses: int, robots: int, tmp_path: Path) -> None:
    way = Trajectory(np.arange(poses, dtype=np.float64), np.cumsum(np.ones((poses, 3)), axis=0))
    tracks = [Track(f"r{k}", way, np.arange(poses) // 10) for k in range(robots)]
    marks = min(poses, 5)
    atlas = Atlas(
        name="any",
        counts={"steps": poses, "observations": 0, "landmarks": marks, "submaps": 1},
        tracks=tracks,
        frames=np.zeros((poses, 3)),
        landmarks=3.0 * np.ones((marks, 2)),
        covariances=np.tile(np.eye(2), (marks, 1, 1)),
        unconnected=["elsewhere"],
    )
    path = tmp_path / "map.png"
    draw(atlas, path)
    assert path.stat().st_size > 10_000


@pytest.mark.parametrize("poses", [0, 40])
def test_a_map_in_space_is_drawn_from_above(poses: int, tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    way = Trajectory(np.arange(poses, dtype=np.float64), np.cumsum(random.normal(size=(poses, 6)), axis=0))
    root = random.normal(size=(poses, 3, 3))
    atlas = Atlas(
        name="any",
        counts={"steps": poses, "observations": 0, "landmarks": poses, "submaps": poses},
        tracks=[Track("r1", way, np.arange(poses))],
        frames=way.poses,
        landmarks=5.0 * random.normal(size=(poses, 3)),
        covariances=root @ root.transpose(0, 2, 1),
        unconnected=[],
    )
    path = tmp_path / "map.svg"
    with matplotlib.rc_context({"svg.fonttype": "none"}):
        draw(atlas, path)
    drawn = path.read_text()
    assert "any, seen from above (x, y)" in drawn
    assert "sub-map frame: z" in drawn
