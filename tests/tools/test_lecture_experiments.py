"""Laws of the experiments beads, flatland, phantom, banana and scaling; nothing here is about time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
import pytest
from numpy.typing import NDArray

from service.experiments import banana, beads, costs, flatland, phantom
from service.experiments.costs import Series
from service.experiments.rows import chosen
from submaps.mapper import Mapper
from submaps.reference import ekf
from submaps.reference.flatland import FAR, NEAR
from submaps.simulation import drive

Floats = NDArray[np.float64]
A = TypeVar("A")
B = TypeVar("B")


class Serial:
    """``Runs`` in this process."""

    def __init__(self, count: int, seed: int = 0) -> None:
        self.count, self.seed = count, seed

    def generators(self, count: int) -> list[np.random.SeedSequence]:
        return np.random.SeedSequence(self.seed).spawn(count)

    def each(self, function: Callable[[A], B], items: Sequence[A], doing: str) -> list[B]:
        return [function(item) for item in items]


def normal(correlation: float) -> Callable[[Floats, Floats], Floats]:
    """The density of two standard normal variables."""
    left = 1.0 - correlation**2

    def p(x: Floats, y: Floats) -> Floats:
        power = (x * x - 2.0 * correlation * x * y + y * y) / left
        return np.asarray(np.exp(-0.5 * power) / (2.0 * math.pi * math.sqrt(left)))

    return p


@pytest.mark.parametrize("correlation", [0.0, 0.3, -0.9])
def test_mutual_information_of_normal_variables(correlation: float) -> None:
    found = banana.mutual_information(normal(correlation), (-8.0, 8.0), (-9.0, 9.0), 400)
    assert found == pytest.approx(-0.5 * math.log(1.0 - correlation**2), abs=1e-12)


@pytest.mark.parametrize("degrees", [0.5, 5.0, 45.0])
def test_mutual_information_of_a_banana_has_converged(degrees: float) -> None:
    sigma = math.radians(degrees)
    p, window = banana.density(sigma), banana.window(sigma)
    coarse, fine = (banana.mutual_information(p, *window, grid) for grid in (800, 1200))
    assert coarse == pytest.approx(fine, abs=1e-8)


def test_exponential_coordinates_are_those_of_the_points() -> None:
    rng = np.random.default_rng(1)
    turn, along = rng.uniform(-2.5, 2.5, 200), 0.2 * rng.normal(size=200)
    found = banana.exponential(banana.curved(turn, along))
    assert np.allclose(found[0], turn, atol=1e-9)
    assert np.allclose(found[1], along, atol=1e-8)


def test_banana() -> None:
    rows = banana.run(Serial(4000)).figures["noises"]
    assert [row["sigma_deg"] for row in rows] == list(banana.DEGREES)
    for row in rows[:-1]:
        assert row["inside_exponential"] == pytest.approx(0.95, abs=0.02)
    assert all(abs(row["correlation"]) < 1e-12 for row in rows)
    shared = [row["mutual_information_nats"] for row in rows[2:]]
    assert shared == sorted(shared)
    assert shared[-1] > 1.5
    assert rows[-1]["inside_linear"] < 0.4
    assert rows[-1]["inside_exponential"] > 0.85
    assert rows[-1]["area_exact_to_exponential"] > 10.0


def test_beads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(beads, "LONG", 2000)
    monkeypatch.setattr(beads, "STEPS", 100)
    figures = beads.run(Serial(20)).figures
    assert figures["closed_form_difference"] < 1e-9
    assert figures["nees_band"][0] < figures["nees"] < figures["nees_band"][1]
    certain, noisy = figures["worlds"]
    assert certain["limit"] == certain["initial_variance"]
    for row in (certain, noisy):
        assert row["limit"] < row["bead_least"] <= row["bead_most"] < 1.005 * row["limit"]
        assert row["difference_last"] < 0.02 * row["difference_first"]
        assert 0.0 < row["correlation_short_of_1"] < 2e-3
    assert noisy["limit"] > certain["limit"]


def test_a_drive_in_pieces_is_the_drive() -> None:
    rng = np.random.default_rng(4)
    world = replace(NEAR, laps=0.3).planted(rng)
    batch, _ = world.drive(rng)
    config = flatland.configure(world, "invariant", submaps=True)
    whole, pieces = Mapper(config), Mapper(config)
    report = whole.apply("robot", batch)
    last = [pieces.apply("robot", piece) for piece, _ in flatland.chunks(batch, 7)][-1]
    assert (last.submap, last.pose) == (report.submap, report.pose)
    assert [end for _, end in flatland.chunks(batch, 7)][-1] == batch.steps - 1


def test_flatland(monkeypatch: pytest.MonkeyPatch) -> None:
    """At a fixed seed: far away only joined sub-maps say how wrong they are."""
    monkeypatch.setitem(flatland.FIELDS, "near", replace(FAR, laps=0.2))
    figures = flatland.run(Serial(12)).figures
    rows = {(row["field"], row["way"]): row for row in figures["ways"]}
    standard, single, joined = (rows["far", way] for way in flatland.WAYS)
    assert joined["submaps"] > 40.0
    assert standard["submaps"] == single["submaps"] == 1.0
    assert joined["nees"] < 1.3
    assert standard["nees"] > 3.0 * joined["nees"]
    assert single["nees"] < standard["nees"]
    assert standard["landmark_nees"] > 5.0 * joined["landmark_nees"]
    assert standard["within_2_sigma"] < 0.9 < joined["within_2_sigma"]
    short = [rows["near", way]["nees"] for way in flatland.WAYS]  # nothing to disagree about yet
    assert max(short) < 1.1 * min(short)


def test_phantom(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(phantom, "SCANS", 500)
    monkeypatch.setattr(phantom, "SCANS_BY_MOMENTS", 40)
    figures = phantom.run(Serial(3)).figures
    assert figures["gain_closed_form_against_numbers"] < 1e-9
    assert figures["invariant_relative_change"] < 1e-6
    rows = {(row["filter"], row["noise"]): row for row in figures["filters"]}
    for key in (("standard EKF", 0.1), ("standard EKF", 1.0), ("second order", 1.0), ("exact moments", 1.0)):
        assert rows[key]["most_deg"] < 0.5 * 5.0
    for noise in phantom.NOISES:
        assert rows["invariant EKF", noise]["median_deg"] == pytest.approx(5.0, rel=1e-6)


def test_slopes_are_those_of_powers() -> None:
    cost = {n: 3.0 * n**2.5 for n in (10, 20, 40)} | {5: 1e9}
    assert Series("", "", 2.5, "", cost=cost, over=(10, 40)).slope == pytest.approx(2.5)


def test_what_is_timed_is_done(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(costs, "_LEAST", 0.0)
    for work in costs.WORK:
        found = costs.measure(costs.Task(work, ((5, 1), (8, 3)), 1))
        assert len(found) == 2
        assert min(found) >= 0.0
    for make in (costs.joint(6, ekf.naive, 2), costs.predicting(6, invariant=True)):
        make(2)
    assert costs.updating(6, 4)(3) == 12


def test_the_street_shows_a_few_landmarks_everywhere(monkeypatch: pytest.MonkeyPatch) -> None:
    world = costs.street(100)
    assert len(world.landmarks) == 100
    batch = drive(world, np.random.default_rng(0)).batch
    seen = np.bincount(batch.observation_step, minlength=batch.steps)
    assert 2 <= seen.min() <= seen.max() <= 6
    assert set(batch.landmark) == {str(i) for i in range(100)}
    monkeypatch.setattr(costs, "CAPACITIES", (10,))
    (_, few), (_, many) = costs.drives((100, 1)) + costs.drives((200, 1))
    assert many == pytest.approx(2.0 * few, rel=0.1)  # bytes follow the landmarks


def test_a_table_is_chosen_from_the_figures() -> None:
    rows: list[dict[str, Any]] = [{"a": 1, "b": 2.0, "c": "x"}, {"a": 3, "b": 4.0, "c": "y"}]
    table = chosen(rows, {"c": "what", "a": "how many"})
    assert table.columns == ("what", "how many")
    assert table.rows == (("x", 1), ("y", 3))
