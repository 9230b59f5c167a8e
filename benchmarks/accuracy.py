"""Landmarks of two files against their batch optima: through HTTP, and with other bounds of a sub-map.

The root mean square distance after rigid alignment, default settings; then, in process, the same
with ``max_heading_sigma`` and ``min_observed_steps`` halved and doubled, together and apart.
As they come (``map`` is held by the first pose alone) the landmarks also turn about the first
pose; that turn is set against its own standard deviation, which the map's covariances tell: the
median, over the landmarks, of the tangential sigma by the distance from the first pose.
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.common import DATA, batch_landmarks, verdict
from service.client import Client
from service.datasets import VICTORIA_PARK, Dataset, read_source
from service.replaying import map_name, replay
from service.standalone import own_service
from submaps.alignment import Alignment, align
from submaps.atlas.joining import join
from submaps.config import MapConfig
from submaps.mapper import Mapper

Floats = NDArray[np.float64]
BARS = {"victoriaPark": 0.05, VICTORIA_PARK: 0.05, "cityTrees10000": 0.01}
FACTORS = (0.5, 1.0, 2.0)


def sources() -> list[str]:
    """Both files where the data sets are, else the copy that comes with gtsam."""
    files = [DATA / "isam" / f"{name}.txt" for name in ("victoriaPark", "cityTrees10000")]
    found = [str(path) for path in files if path.is_file()]
    return found or [VICTORIA_PARK]


def through_http(run: Dataset, optimum: Floats, names: list[str]) -> None:
    with own_service() as url, Client(url) as client:
        done = replay(client, run, map_name(run), lambda *_: None)
        path = f"/v1/maps/{done.map}/landmarks"
        covariances = {one["id"]: one["covariance"] for one in client.pages(path, "landmarks", frame="map")}
    points = np.array([done.points[name] for name in names])
    found = align(points, optimum)
    print(f"{run.name} through HTTP: {done.submaps} sub-maps, as it comes {found.rmse_before:.4f} m")
    print("  " + verdict("landmark RMSE, aligned (m)", found.rmse, BARS[Path(run.name).stem]))
    turn, sigma = turn_about_origin(points, optimum, np.array([covariances[name] for name in names]))
    print(f"  turn about the first pose {turn:+.5f} rad, its sigma {sigma:.5f} rad")
    print("  " + verdict("turn by its sigma", abs(turn) / sigma, 2.0))


def turn_about_origin(points: Floats, optimum: Floats, covariances: Floats) -> tuple[float, float]:
    """The least-squares turn (rad) of the points about (0, 0) from the optimum, and its sigma."""
    cross = np.sum(optimum[:, 0] * points[:, 1] - optimum[:, 1] * points[:, 0])
    turn = float(np.arctan2(cross, np.sum(optimum * points)))
    distance = np.hypot(points[:, 0], points[:, 1])
    tangent = np.column_stack([-points[:, 1], points[:, 0]]) / distance[:, None]
    variance = np.einsum("ni,nij,nj->n", tangent, covariances, tangent) / distance**2
    return turn, float(np.sqrt(np.median(variance)))


def joined(run: Dataset, config: MapConfig) -> Mapper:
    mapper = Mapper(config)
    for _, batch in run.batches():
        mapper.apply("robot", batch)
        if mapper.solve_due:
            mapper.install(join(mapper.problem()))
    mapper.install(join(mapper.problem()))
    return mapper


def aligned(mapper: Mapper, optimum: Floats, names: list[str]) -> Alignment:
    view = mapper.view()
    at = [view.landmark(name, "map") for name in names]
    return align(np.array([[one.x, one.y] for one in at]), optimum)


def bounds(run: Dataset, optimum: Floats, names: list[str]) -> None:
    default = MapConfig(run.motion, run.observation)
    for by_sigma, by_steps in itertools.product(FACTORS, FACTORS):
        sigma = by_sigma * default.max_heading_sigma
        steps = max(round(by_steps * default.min_observed_steps), 1)
        mapper = joined(run, replace(default, max_heading_sigma=sigma, min_observed_steps=steps))
        label = (
            f"  {sigma:.3f} rad, {steps:2d} steps, {mapper.view().submap_count:4d} sub-maps: landmark RMSE, aligned (m)"
        )
        print(verdict(label, aligned(mapper, optimum, names).rmse, 2.0 * BARS[Path(run.name).stem]))


def beside(run: Dataset, optimum: Floats, names: list[str]) -> None:
    """What the design is up against: no bound on position, and one map for everything."""
    default = MapConfig(run.motion, run.observation)
    whole = replace(default, max_landmarks=1000, max_heading_sigma=1e9, max_position_sigma=1e9)
    ways = {
        "0.020 rad without the bound on position": replace(default, max_heading_sigma=0.02, max_position_sigma=1e9),
        "one right-invariant map": whole,
        "one standard EKF": replace(whole, filter="standard"),
    }
    for name, config in ways.items():
        found = aligned(joined(run, config), optimum, names)
        print(f"  beside, {name}: {found.rmse:.3f} m, as it comes {found.rmse_before:.3f} m")


def main() -> None:
    for source in sources():
        run = read_source(source)
        landmarks = batch_landmarks(run)
        names = list(landmarks)
        optimum = np.array([landmarks[name] for name in names])
        through_http(run, optimum, names)
        bounds(run, optimum, names)
        beside(run, optimum, names)


if __name__ == "__main__":
    main()
