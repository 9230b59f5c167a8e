"""Real files: landmarks of the joined sub-maps against the batch optimum of the same measurements."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from service.datasets.dataset import Dataset
from service.datasets.isam import read_isam
from submaps.alignment import align
from submaps.atlas.joining import join
from submaps.batch import optimum
from submaps.config import MapConfig
from submaps.mapper import Mapper

BARS = {"victoriaPark": 0.05, "cityTrees10000": 0.01}


@dataclass(frozen=True)
class Case:
    """A file, its batch optimum's landmarks, and the bar (m) for the default settings."""

    run: Dataset
    names: list[str]
    landmarks: NDArray[np.float64]
    bar: float


@pytest.fixture(scope="module", params=sorted(BARS))
def case(request: pytest.FixtureRequest, data_dir: Path) -> Case:
    run = read_isam(data_dir / "isam" / f"{request.param}.txt")
    best = optimum(run.columns, run.motion, run.observation)
    return Case(run, list(best.ids), best.landmarks, BARS[request.param])


def joined(case: Case, config: MapConfig) -> NDArray[np.float64]:
    """Landmarks (n, 2) after the whole file, solved whenever a solve was due."""
    mapper = Mapper(config)
    for _, batch in case.run.batches():
        mapper.apply("robot", batch)
        if mapper.solve_due:
            mapper.install(join(mapper.problem()))
    mapper.install(join(mapper.problem()))
    view = mapper.view()
    found = [view.landmark(name) for name in case.names]
    return np.array([(one.x, one.y) for one in found])


def test_defaults(case: Case) -> None:
    config = MapConfig(case.run.motion, case.run.observation)
    assert align(joined(case, config), case.landmarks).rmse <= case.bar


@pytest.mark.parametrize("sigma", [0.5, 2.0])
@pytest.mark.parametrize("steps", [0.5, 2.0])
def test_bounds_halved_and_doubled(case: Case, sigma: float, steps: float) -> None:
    config = MapConfig(case.run.motion, case.run.observation)
    config = replace(
        config,
        max_heading_sigma=sigma * config.max_heading_sigma,
        min_observed_steps=round(steps * config.min_observed_steps),
    )
    assert align(joined(case, config), case.landmarks).rmse <= 2.0 * case.bar


def test_every_landmark_has_an_honest_covariance(case: Case) -> None:
    mapper = Mapper(MapConfig(case.run.motion, case.run.observation))
    mapper.apply("robot", case.run.columns)
    mapper.install(join(mapper.problem()))
    found, rest = mapper.view().landmarks(0, 1000)
    assert rest is None
    assert sorted(one.id for one in found) == sorted(case.names)
    for one in found:
        assert np.linalg.eigvalsh(one.covariance)[0] > 0.0
