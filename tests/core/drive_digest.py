"""Print digests of a simulated drive: sub-maps, track, a solve taken from its columns, landmarks found.

Run as ``python -m tests.core.drive_digest MEASUREMENTS.npz COLUMNS.npz``: the measurements come
ready made, so that nothing but the estimator decides what is printed. Where the columns of the
solve do not exist yet they are written, as a journal would.
"""

from __future__ import annotations

import hashlib
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from submaps.association.methods import METHODS
from submaps.atlas.joining import join
from submaps.atlas.solution import Solution
from submaps.config import MapConfig, MotionConfig, ObservationConfig
from submaps.mapper import Mapper
from submaps.measurements import Batch
from tests.core.support import cut

MOTION = MotionConfig("velocity", (0.05, 0.02, 0.01))
SENSOR = ObservationConfig("range_bearing", (0.1, 0.01), (0.3, -0.1, 0.2))
CONFIG = MapConfig(MOTION, SENSOR, max_landmarks=6, gate=0.9999)


def read(path: Path) -> Batch:
    """The measurements of a drive."""
    with np.load(path) as f:
        return Batch(
            t=f["t"], control_step=f["control_step"], control=f["control"], control_covariance=None,
            observation_step=f["observation_step"], landmark=tuple(str(i) for i in f["landmark"]), z=f["z"],
            observation_covariance=None,
        )  # fmt: skip


def digests(measurements: Path, columns: Path) -> list[str]:
    """One digest for each filter and stage of the drive, and one for each method of association."""
    run = read(measurements)
    out = []
    for name in ("invariant", "standard"):
        mapper = Mapper(replace(CONFIG, filter=name))
        half = run.steps // 2
        reports = [mapper.apply("a", cut(run, 0, half))]
        state = mapper.problem()
        out.append(f"{name} state {state.digest().hex()}")
        kept = columns.with_name(f"{name}_{columns.name}")
        if not kept.exists():
            np.savez(kept, **join(state).columns())  # type: ignore[arg-type]
        with np.load(kept) as f:
            mapper.install(Solution.from_columns(state, dict(f)))
        reports += [mapper.apply("a", cut(run, half, run.steps))]
        last = mapper.problem()
        track = hashlib.blake2b(b"".join(r.track_pose.tobytes() for r in reports), digest_size=16)
        out.append(f"{name} submaps {last.submap_count} {last.digest().hex()} track {track.hexdigest()}")
        odom = mapper.view().pose("a", "odom")
        out.append(f"{name} odom {odom.x.hex()} {odom.y.hex()} {odom.theta.hex()}")
    for method in METHODS:
        mapper = Mapper(replace(CONFIG, association=method))  # type: ignore[arg-type]
        report = mapper.apply("a", replace(run, landmark=("",) * run.observations))
        found = hashlib.blake2b(repr((report.found, report.rejected)).encode(), digest_size=16)
        out.append(f"{method} {mapper.problem().digest().hex()} found {found.hexdigest()}")
    return out


if __name__ == "__main__":
    print("\n".join(digests(Path(sys.argv[1]), Path(sys.argv[2]))))
