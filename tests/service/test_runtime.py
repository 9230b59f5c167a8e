"""A map is a function of its events: live and replayed, to the last bit."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import orjson
import pytest

from service.runtime import Configured, MapEvent, Measured, Runtime, Solved
from service.wire.base import parse
from service.wire.columns import ROWS_TYPE, decode
from service.wire.maps import MAP_REQUEST
from submaps.atlas.joining import join
from submaps.config import RobotConfig
from submaps.errors import DigestMismatch
from submaps.measurements import Batch, Report
from tests.service.support import ODOMETRY_MAP, batches

CORE = parse(MAP_REQUEST, json.dumps(ODOMETRY_MAP).encode()).to_core()


def measured(count: int, size: int) -> list[Batch]:
    return [decode(ROWS_TYPE, json.dumps(b).encode(), CORE, "r1").batch for b in batches(count, size)]


def bits(runtime: Runtime) -> bytes:
    """Return all that the map knows."""
    view = runtime.view()
    return orjson.dumps({
        "version": view.version,
        "counts": view.counts(),
        "robots": view.robots(),
        "pose": view.pose("r0", "map"),
        "landmarks": view.landmarks(0, 1000, "map", None),
        "submaps": [view.submap(k) for k in range(view.submap_count)],
        "edges": view.edges(),
    }, default=np.ndarray.tolist, option=orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_SERIALIZE_DATACLASS)  # fmt: skip


def drive(solve_at: set[int], late: int) -> tuple[Runtime, list[MapEvent], list[Report]]:
    """Drive live: a problem is captured at each of ``solve_at``, its solve comes in ``late`` batches later."""
    live = Runtime(CORE)
    events: list[MapEvent] = []
    reports = []
    due: dict[int, Solved] = {}
    for number, batch in enumerate(measured(24, 10)):
        event = Measured(live.position + 1, f"r{number % 2}", batch)
        events.append(event)
        report = live.apply(event)
        assert report is not None
        reports.append(report)
        if number in solve_at:
            base, problem = live.capture()
            columns = join(problem).columns()
            due[number + late] = Solved(0, base, problem.digest(), columns)
        if number in due:
            solved = replace(due[number], position=live.position + 1)
            events.append(solved)
            live.apply(solved)
    return live, events, reports


@pytest.mark.parametrize(("solve_at", "late"), [(set(), 0), ({8, 15, 23}, 0), ({4, 12, 18}, 3)])
def test_a_replay_reaches_the_same_bits(solve_at: set[int], late: int) -> None:
    live, events, reports = drive(solve_at, late)
    bases = frozenset(event.base for event in events if isinstance(event, Solved))
    again = Runtime(CORE, bases)
    replayed = [report for event in events if (report := again.apply(event)) is not None]
    assert bits(again) == bits(live)
    assert again.version == live.version == len(solve_at)
    for one, other in zip(reports, replayed, strict=True):
        assert one.track_pose.tobytes() == other.track_pose.tobytes()
        np.testing.assert_array_equal(one.track_submap, other.track_submap)
        assert (one.pose, one.submap, one.rejected, one.flagged) == (
            other.pose, other.submap, other.rejected, other.flagged)  # fmt: skip


def test_captures_that_came_to_nothing_leave_no_trace() -> None:
    live, events, _ = drive({8}, 0)
    again = Runtime(CORE, frozenset(range(100)))  # captures everywhere
    for event in events:
        again.apply(event)
    assert bits(again) == bits(live)


def test_a_solve_of_another_state_is_refused() -> None:
    _, events, _ = drive({15}, 2)
    solved = next(event for event in events if isinstance(event, Solved))
    for wrong in (replace(solved, problem_digest=b"x" * 16), replace(solved, base=solved.base - 1)):
        again = Runtime(CORE, frozenset([solved.base]))
        at = events.index(solved)
        for event in events[:at]:
            again.apply(event)
        with pytest.raises(DigestMismatch):
            again.apply(wrong)


def test_what_sets_a_robot_apart_is_replayed_in_its_place() -> None:
    surer = replace(CORE.motion, sigma=tuple(0.5 * s for s in CORE.motion.sigma))
    own = RobotConfig(surer, CORE.observation)
    _, events, _ = drive({8, 15}, 2)
    bases = frozenset(event.base for event in events if isinstance(event, Solved))
    moved = [replace(event, position=event.position + 1) for event in events if not isinstance(event, Solved)]
    found = []
    for first in ([Configured(1, "r1", own)], [Configured(1, "r0", own)], [Configured(1, "r9", own)]):
        live, again = Runtime(CORE), Runtime(CORE, bases)
        for event in (*first, *moved):
            live.apply(event)
            again.apply(event)
        assert bits(again) == bits(live)
        found.append(bits(live))
    assert len(set(found)) == 3  # r9 never came
