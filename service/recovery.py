"""The ordinary start: every map as its journal says."""

from __future__ import annotations

import logging
from collections.abc import Iterator

from service.applying import apply_batch, apply_robot, apply_solve
from service.hosted import Admitted, Hosted
from service.runtime import Runtime
from service.store.base import BatchEvent, Journal, MapRecord, RobotEvent
from service.store.encoding import decode_batch
from service.wire.base import parse
from service.wire.maps import CONFIG
from service.wire.robots import ROBOTS

log = logging.getLogger(__name__)


def recover(journal: Journal) -> Iterator[Hosted]:
    """Yield the maps of a journal, each replayed; what was derived and not kept is kept now."""
    for record in journal.maps():
        hosted = replay(journal, record)
        log.info("recovered map %r: %d events", record.id, hosted.position)
        yield hosted


def replay(journal: Journal, record: MapRecord) -> Hosted:
    """Return one map as its events say; where one cannot be applied, the map is halted there."""
    core = parse(CONFIG, record.config).to_core()
    runtime = Runtime(core, journal.solve_bases(record.key))
    hosted = Hosted(record.key, record.id, record.config, core, runtime, runtime.view())
    try:
        for event, kept in journal.events(record.key):
            if isinstance(event, BatchEvent):
                batch = decode_batch(event.data)
                derived = apply_batch(hosted, event, batch)
                hosted.admitted[event.robot] = Admitted(event.sequence, float(batch.t[-1]))
                if not kept:
                    journal.derive([derived])
            elif isinstance(event, RobotEvent):
                own = parse(ROBOTS[core.space], event.data).to_core()
                apply_robot(hosted, event, own)
                hosted.own[event.robot] = own
            else:
                hosted.keep(event.number, apply_solve(hosted, event))
                hosted.begun = event.number
            hosted.position = event.position
    except Exception as error:
        log.exception("map %r cannot be replayed past event %d", record.id, hosted.position)
        hosted.halted = f"event {hosted.position + 1} cannot be replayed ({error})"
    hosted.view = runtime.view()
    return hosted
