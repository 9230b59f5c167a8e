"""Laws of the experiment on data association, and of the one map that it drives."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from service.experiments import association
from service.experiments.association_runs import by_method, likeliest_mistake, run, with_mistake
from service.experiments.association_world import CLUTTER, simulate
from service.experiments.one_map import OneMap
from service.experiments.runner import Workers
from submaps.config import ObservationConfig
from submaps.consistency import average_bounds, nees
from submaps.geometry.space import PLANE
from tests.core.filters import DenseFilter, minus
from tests.core.support import random_covariance

SENSOR = ObservationConfig("range_bearing", (0.1, 0.02))


def test_one_map_is_the_right_invariant_filter() -> None:
    """Against one by numeric Jacobians: prediction, a new landmark, an update, and the error of either."""
    rng = np.random.default_rng(0)
    one, dense = OneMap(), DenseFilter(np.zeros(3), np.zeros((3, 3)), True, SENSOR)
    R = np.diag([0.01, 0.0004])
    for k in range(6):
        increment, noise = rng.normal(size=3) * 0.3, random_covariance(rng, 3, 0.05)
        one.predict(increment, noise)
        dense.predict(increment, noise)
        z = np.array([3.0 + k, 0.3 * k - 0.5])
        one.augment(z[np.newaxis], R)
        dense.augment(z, R)
        slot = k // 2
        seen = one.candidates(z[np.newaxis] * 0.0 + one.candidates(z[np.newaxis], R).readings.h[slot] + 0.02, R)
        z = seen.readings.h[slot] + 0.02
        one.update(seen, np.array([0]), np.array([slot]))
        dense.update(3 + 2 * slot, z, R)
        assert np.allclose(minus(PLANE, one.x, dense.x, True), 0.0, atol=1e-8)
        assert np.allclose(one.P, dense.P, atol=1e-9)
    truth = dense.x + rng.normal(size=dense.x.size) * 0.1
    xi = one.error(truth[:3], truth[3:].reshape(-1, 2))
    assert np.allclose(xi, minus(PLANE, truth, one.x, True), atol=1e-6)
    one.drop(np.array([0, 3]))
    kept = [0, 1, 2, 5, 6, 7, 8, 11, 12, 13, 14]
    assert np.allclose(one.x, dense.x[kept], atol=1e-8)
    assert np.allclose(one.P, dense.P[np.ix_(kept, kept)], atol=1e-9)


def test_with_what_is_known_nothing_is_wrong_and_the_map_is_consistent() -> None:
    whole = []
    for seed in np.random.SeedSequence(1).spawn(4):
        drive = simulate(seed, 1.0, 2.0)
        done = run(drive, by_method("known"))
        assert (done.tally.wrong, done.tally.missed, done.tally.taken) == (0, 0, 0)
        assert done.tally.clutter == sum(int(np.count_nonzero(s.truth == CLUTTER)) for s in drive.scans) > 300
        assert sorted(done.origin.tolist()) == list(range(60))
        pose = drive.scans[-1].pose
        xi = done.estimate.error(pose, drive.landmarks[done.origin])
        assert done.map_nees == pytest.approx(nees(xi, done.estimate.P) / xi.size)
        whole.append(done.map_nees)
    low, high = average_bounds(0.999, 123, 4)
    assert low < float(np.mean(whole)) < high


def test_a_mistake_that_is_not_made_costs_nothing_and_one_that_is_made_is_felt() -> None:
    drive = simulate(np.random.SeedSequence(2), 1.5, 0.0)
    mistake = likeliest_mistake(drive, 20, 150)
    assert mistake.apart >= 1.5
    assert 20 <= mistake.step <= 150
    right = with_mistake(drive, mistake, made=False, after="known")
    wrong = with_mistake(drive, mistake, made=True, after="known")
    assert (right.tally.wrong, wrong.tally.wrong) == (0, 1)
    at = mistake.step - 1
    assert np.array_equal(right.nees[:at], wrong.nees[:at])
    assert wrong.nees[at] > 5.0 * right.nees[at]
    assert wrong.map_nees > right.map_nees


def test_the_outcome_is_that_of_its_seed_and_can_be_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(association, "CELLS", ((1.0, 0.0), (1.0, 2.0)))
    monkeypatch.setattr(association, "CLUTTERS", (0.0, 2.0))
    with Workers(1, 3, quiet=True) as runs:
        one, other = (association.EXPERIMENT.run(runs) for _ in range(2))
    assert len(one.table.rows) == 8
    assert all(len(row) == len(one.table.columns) for row in one.table.rows)
    assert all(len(row) == len(one.series.columns) for row in one.series.rows)
    timed = one.series.columns.index("microseconds")
    for a, b in zip(one.series.rows, other.series.rows, strict=True):
        assert [v for k, v in enumerate(a) if k != timed] == [v for k, v in enumerate(b) if k != timed]
    for cell in one.figures["cells"]:
        assert cell["correct"] + cell["wrong"] + cell["missed"] == pytest.approx(1.0)
        assert math.isfinite(cell["map_rmse"])
    figure = Figure(figsize=one.size)
    one.draw(figure)
    figure.savefig(tmp_path / "association.png")
    assert (tmp_path / "association.png").stat().st_size > 20_000
    assert len(one.assumptions) > 3
