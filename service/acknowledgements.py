"""The acknowledgement of a batch, and what is kept along with it."""

from __future__ import annotations

from typing import Any

import numpy as np
import orjson

from service.store.base import BatchEvent, Derived
from service.store.encoding import encode_track
from service.wire.poses import pose_answer
from submaps.measurements import Batch, Rejection, Report, as_encounter


def derive(event: BatchEvent, batch: Batch, report: Report, version: int) -> Derived:
    """Return what the journal keeps of a batch that was applied: acknowledgement and track."""
    return Derived(
        map=event.map,
        robot=event.robot,
        sequence=event.sequence,
        began=float(batch.t[0]),
        ended=float(batch.t[-1]),
        acknowledgement=_acknowledgement(event.sequence, batch, report, version),
        track=encode_track(batch.t, report),
    )


def as_duplicate(acknowledgement: bytes) -> bytes:
    """Return an acknowledgement as a repeat of the batch gets it."""
    return orjson.dumps(orjson.loads(acknowledgement) | {"duplicate": True})


def _acknowledgement(sequence: int, batch: Batch, report: Report, version: int) -> bytes:
    found = {} if report.found is None else {"landmarks": report.found}
    return orjson.dumps({
        "sequence": sequence,
        "steps": batch.steps,
        "observations": batch.observations,
        "rejected": [_set_aside(r, batch) for r in report.rejected],
        "flagged": [_set_aside(r, batch) for r in report.flagged],
        "submap": report.submap,
        "map_version": version,
        "duplicate": False,
        "pose": {"frame": f"submap/{report.submap}", "t": report.t, **pose_answer(report.pose)},
        **found,
    })  # fmt: skip


def _set_aside(rejection: Rejection, batch: Batch) -> dict[str, Any]:
    at, what = rejection.observation, {"landmark": rejection.landmark}
    met = as_encounter(rejection.landmark)
    if met is not None:
        at, what = at - _landmarks_at(batch, rejection.step), {"robot": met[0]}
    return {"step": rejection.step, "observation": at, **what, "reason": rejection.reason, "nis": rejection.nis}


def _landmarks_at(batch: Batch, step: int) -> int:
    """Return how many observations of landmarks a step has; its encounters follow them."""
    begin, end = np.searchsorted(batch.observation_step, [step, step + 1])
    return sum(as_encounter(name) is None for name in batch.landmark[begin:end])
