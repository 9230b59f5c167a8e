"""Laws of maps whose observations do not say what they are of."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from benchmarks.consistency import configure, errors
from submaps.associating import CARRIED_SUBMAPS, MOST_CARRIED, Associator
from submaps.atlas.joining import join
from submaps.config import DEFAULT_GATE, DEFAULT_NEW_GATE, AssociationName, MapConfig, MotionConfig, ObservationConfig
from submaps.consistency import average_bounds
from submaps.errors import ConfigError
from submaps.flight import config_of, fly, loops
from submaps.geometry.space import PLANE
from submaps.mapper import Mapper
from submaps.measurements import Batch, Report
from submaps.simulation import Run, World, circle, drive
from tests.core.support import ODOMETRY, Step, batch, cut
from tests.core.test_encounters import CONFIG as TWO_ROBOTS
from tests.core.test_encounters import world

METHODS = [name for name in get_args(AssociationName) if name != "known"]
QUIET = {"gate": 0.9999, "new_gate": 0.999999}
every = pytest.mark.parametrize("method", METHODS)


def anonymous(b: Batch) -> Batch:
    """Without the names of landmarks; encounters keep theirs."""
    return replace(b, landmark=tuple(name if name.startswith("\x1f") else "" for name in b.landmark))


def of(config: MapConfig, method: str, **changes: object) -> MapConfig:
    return replace(config, association=method, **changes)  # type: ignore[arg-type]


def origins(b: Batch, found: tuple[str | None, ...]) -> dict[str, set[str]]:
    """The true landmarks whose readings each of the map's was given."""
    out: dict[str, set[str]] = {}
    for true, name in zip(b.landmark, found, strict=True):
        if name is not None:
            out.setdefault(name, set()).add(true)
    return out


def quiet(laps: float) -> tuple[World, Run]:
    """The circle with a tenth of its noise."""
    w = circle(laps)
    w = replace(w, velocity_sigma=(0.005, float(np.deg2rad(0.5))), observation_sigma=0.025)
    return w, drive(w, np.random.default_rng(1))


# -- without much noise nothing is lost --------------------------------------------------------


@every
@pytest.mark.parametrize(("one_map", "laps", "landmarks"), [(True, 1.1, 20), (False, 0.9, 18)])
def test_the_map_is_that_of_known_landmarks_up_to_their_names(
    method: str, one_map: bool, laps: float, landmarks: int
) -> None:
    """To the last bit: the same numbers, taken in by the same walk; over sub-maps as well."""
    w, run = quiet(laps)
    config = configure(w, "invariant", one_map)
    known, found = Mapper(config), Mapper(of(config, method, **QUIET))
    known.apply("r", run.batch)
    report = found.apply("r", anonymous(run.batch))
    assert report.rejected == ()
    assert report.found is not None
    assert all(len(true) == 1 for true in origins(run.batch, report.found).values())
    assert found.view().counts()["landmarks"] == landmarks
    assert found.problem().digest() == known.problem().digest()
    views = []
    for mapper in (known, found):
        mapper.install(join(mapper.problem()))
        views.append(mapper.view())
    assert (views[1].submap_count > 5) != one_map
    for number, name in enumerate(dict.fromkeys(run.batch.landmark)):
        one, other = views[0].landmark(name, "map"), views[1].landmark(f"~{number}", "map")
        assert (one.x, one.y, one.submaps) == (other.x, other.y, other.submaps)


@every
def test_names_are_a_tilde_and_a_number_in_order_of_sighting(method: str) -> None:
    seen = [("", (3.0, 1.0)), ("", (3.0, -2.0)), ("", (5.0, 0.5))]
    mapper = Mapper(of(ODOMETRY, method))
    report = mapper.apply("a", batch([Step(None, seen), Step((0.0, 0.0, 0.0), seen[::-1])]))
    assert report.found == ("~0", "~1", "~2", "~2", "~1", "~0")
    assert [one.id for one in mapper.view().landmarks()[0]] == ["~0", "~1", "~2"]


@every
def test_how_a_drive_is_cut_into_batches_changes_nothing(method: str) -> None:
    w = circle(0.6)
    b = anonymous(drive(w, np.random.default_rng(2)).batch)
    whole = Mapper(of(configure(w, "invariant", False), method))
    reference = whole.apply("r", b)
    for size in (1, 37):
        parts = Mapper(of(configure(w, "invariant", False), method))
        reports = [parts.apply("r", cut(b, k, min(k + size, b.steps))) for k in range(0, b.steps, size)]
        assert sum((r.found or () for r in reports), ()) == reference.found
        assert parts.view().submap_count == whole.view().submap_count
        assert np.allclose(np.concatenate([r.track_pose for r in reports]), reference.track_pose, atol=1e-9)


@every
def test_the_same_batches_give_the_same_bits(method: str) -> None:
    w = circle(1.1)
    b = anonymous(drive(w, np.random.default_rng(3)).batch)
    one, other = (Mapper(of(configure(w, "standard", False), method)) for _ in range(2))
    reports = [mapper.apply("r", b) for mapper in (one, other)]
    assert reports[0].found == reports[1].found
    assert reports[0].rejected == reports[1].rejected
    assert one.problem().digest() == other.problem().digest()


# -- the gates ---------------------------------------------------------------------------------


def test_between_the_gates_nothing_is_taken_in_and_it_is_said() -> None:
    """sigma of the innovation is 0.1 sqrt(2) m, so 0.99 lies at 0.43 m and 0.99999 at 0.68 m."""
    mapper = Mapper(of(ODOMETRY, "joint"))
    mapper.apply("a", batch([Step(None, [("", (3.0, 0.0))])]))
    near, between, far = (3.3, 0.0), (3.55, 0.0), (3.9, 0.0)
    report = mapper.apply("a", batch([Step(None, [("", between)]), Step(None, [("", far)])], start=0.1))
    assert report.found == (None, "~1")
    (aside,) = report.rejected
    assert (aside.step, aside.observation, aside.landmark, aside.reason) == (0, 0, "~0", "ambiguous")
    assert aside.nis == pytest.approx(0.55**2 / 0.02, rel=1e-6)
    assert mapper.view().counts()["rejected"] == 1
    assert mapper.view().counts()["observations"] == 2
    # Two readings of one landmark in one step: the likelier is taken, the other is ambiguous.
    twice = mapper.apply("a", batch([Step(None, [("", near), ("", (3.05, 0.0))])], start=0.4))
    assert twice.found == (None, "~0")
    assert [one.reason for one in twice.rejected] == ["ambiguous"]


def test_what_a_configuration_may_say() -> None:
    found = of(ODOMETRY, "greedy")
    assert (found.gate, found.new_gate) == (DEFAULT_GATE, DEFAULT_NEW_GATE)
    assert not found.named
    assert ODOMETRY.named
    bad: list[tuple[str, dict[str, object]]] = [
        ("association.method", {"association": "nearest"}),
        ("association.new_gate", {"new_gate": 0.99}),
        ("association.new_gate", {"association": "joint", "gate": 0.99, "new_gate": 0.98}),
        ("association.new_gate", {"association": "joint", "new_gate": 1.0}),
        ("association.gate", {"association": "joint", "gate": 1.0}),
    ]
    for field, changes in bad:
        with pytest.raises(ConfigError) as error:
            replace(ODOMETRY, **changes)  # type: ignore[arg-type]
        assert error.value.field == field
    still = MotionConfig("none", ())
    with pytest.raises(ConfigError) as error:
        MapConfig(still, ObservationConfig("cartesian3d", (0.1,) * 3), space="se3", association="joint")
    assert error.value.field == "association.method"


# -- identities over sub-maps ------------------------------------------------------------------


def test_landmarks_are_carried_into_the_next_frame_with_their_joint_covariance() -> None:
    """y = R^T (l - p) of samples of the closed sub-map's own Gaussian: their mean and covariance."""
    w = circle(0.3)
    mapper = Mapper(of(configure(w, "invariant", False), "joint"))
    mapper.apply("r", anonymous(drive(w, np.random.default_rng(4)).batch))
    associator = mapper._associator
    assert isinstance(associator, Associator)
    carried = associator._carried["r"]
    last = mapper.view().state.submap(mapper.view().submap_count - 2)
    held = last.landmarks.shape[0]
    assert 0 < held < carried.numbers.size <= MOST_CARRIED
    assert carried.numbers[:held].tolist() == last.landmarks.tolist()
    assert carried.age[:held].tolist() == [0] * held
    assert set(carried.age[held:].tolist()) <= set(range(1, CARRIED_SUBMAPS + 1))
    xi = np.random.default_rng(5).multivariate_normal(np.zeros(last.mean.size), last.covariance(), 40_000)
    R = PLANE.rotation(last.mean[:3])
    points = last.mean[3:].reshape(-1, 2)
    y = (points - last.mean[:2]) @ R
    assert np.allclose(carried.at[:held], y)
    errors_ = (xi[:, 3:].reshape(-1, held, 2) - xi[:, np.newaxis, :2]) @ R
    sampled = np.cov(errors_.reshape(-1, 2 * held).T)
    own = carried.covariance[: 2 * held, : 2 * held]
    assert np.abs(sampled - own).max() < 0.05 * np.abs(own).max()


@every
def test_poses_and_landmarks_are_consistent(method: str) -> None:
    w, runs, values = circle(0.9), 20, []
    for seed in range(runs):
        run = drive(w, np.random.default_rng([11, seed]))
        mapper = Mapper(of(configure(w, "invariant", False), method))
        report = mapper.apply("r", anonymous(run.batch))
        mapper.install(join(mapper.problem()))
        assert all(len(true) == 1 for true in origins(run.batch, report.found or ()).values())
        values.append(errors(mapper.view().pose("r"), run.poses[-1])[0])
    low, high = average_bounds(0.99, 3, runs)
    assert low <= float(np.mean(values)) <= high


def test_in_space_as_in_the_plane() -> None:
    rng = np.random.default_rng(6)
    volume = loops(rng, landmarks=120, steps=120, share=0.02)
    flight = fly(volume, rng)
    mapper = Mapper(of(config_of(volume, one_map=True), "joint"))
    report = mapper.apply("r", anonymous(flight.batch))
    true = origins(flight.batch, report.found or ())
    assert all(len(names) == 1 for names in true.values())
    assert len(true) == len(set(flight.batch.landmark))


# -- robots that see one another ---------------------------------------------------------------


def apply_in_turn(config: MapConfig, batches: dict[str, Batch], order: str, chunk: int) -> tuple[Mapper, list[Report]]:
    mapper, steps = Mapper(config), batches["a"].steps
    turns = [(name, begin) for begin in range(0, steps, chunk) for name in order]
    reports = [mapper.apply(name, cut(batches[name], k, min(k + chunk, steps))) for name, k in turns]
    mapper.install(join(mapper.problem()))
    return mapper, reports


@pytest.mark.parametrize(("order", "chunk"), [("ab", 20), ("ba", 20), ("ba", 401)])
def test_sightings_of_robots_tie_their_maps_as_ever(order: str, chunk: int) -> None:
    """Marks that wait, come in time and come late; no reading is taken for the place where a robot was seen."""
    batches, _ = world(3, offset=0.04)
    known, as_known = apply_in_turn(TWO_ROBOTS, batches, order, chunk)
    unnamed = {name: anonymous(b) for name, b in batches.items()}
    found, reports = apply_in_turn(of(TWO_ROBOTS, "joint", **QUIET), unnamed, order, chunk)
    assert all(name is None or name.startswith("~") for r in reports for name in r.found or ())
    aside = [one.reason for r in reports for one in r.rejected]
    late = [one.landmark for r in as_known for one in r.rejected]
    assert aside.count("late") == len(late)
    assert (len(late) > 5) == (chunk == 401)
    # Two landmarks are too close to tell apart: what is set aside for that is all that parts the maps.
    assert set(aside) <= {"late", "ambiguous"}
    assert known.view().counts()["observations"] - found.view().counts()["observations"] == aside.count("ambiguous")
    assert found.view().connected(1)
    one, other = known.view().pose("b"), found.view().pose("b")
    assert (other.x, other.y) == pytest.approx((one.x, one.y), abs=0.2 * float(np.sqrt(one.covariance[0, 0])))
