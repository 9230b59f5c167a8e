"""A robot's trajectory as a stream: one piece for each batch that the journal holds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
import orjson
from numpy.typing import NDArray

from service.hosted import Hosted
from service.store.base import Journal
from service.store.encoding import decode_track
from service.wire.poses import pose_answer, tum_rest
from submaps.atlas.view import View
from submaps.geometry.space import Pose, Space


@dataclass(frozen=True)
class Piece:
    """Poses, n of them, in the frame asked for, at times (n,) s, each from the filter of a sub-map (n,)."""

    t: NDArray[np.float64]
    submap: NDArray[np.int32]
    pose: Sequence[Pose]


@dataclass(frozen=True)
class Stream:
    """Pieces of a trajectory, all seen with the sub-maps of one version."""

    map_version: int
    pieces: Iterator[Piece]


def poses(journal: Journal, hosted: Hosted, robot: str, frame: str, span: tuple[float, float]) -> Stream:
    """Return a robot's filtered poses in ``frame`` within a span of its time (s, s).

    The first piece is made at once, so that a frame which cannot be reached is an error rather than
    a broken stream.
    """
    journal.flush()
    kept = journal.tracks(hosted.key, robot, *span)
    first = next(kept, None)
    if first is None:
        return Stream(hosted.view.version, iter(()))
    # The view is taken after the first read: it knows every sub-map that the read can bring.
    view = hosted.view
    frames: dict[int, Pose] = {}
    pieces = (_piece(data, hosted.core.geometry, view, frame, frames, span) for data in chain([first], kept))
    return Stream(view.version, chain([next(pieces)], pieces))


def _piece(
    data: bytes, space: Space, view: View, frame: str, frames: dict[int, Pose], span: tuple[float, float]
) -> Piece:
    track = decode_track(data)
    within = (track.t >= span[0]) & (track.t <= span[1])
    t, submap = track.t[within], track.submap[within]
    if frame == "odom":
        return Piece(t, submap, [tuple(pose) for pose in track.odom[within].tolist()])
    numbers = submap.tolist()
    for k in set(numbers) - frames.keys():
        frames[k] = view.frame_in(k, frame)
    rows = zip(numbers, track.pose[within].tolist(), strict=True)
    return Piece(t, submap, [space.compose(frames[k], tuple(pose)) for k, pose in rows])


def as_json(stream: Stream, robot: str, frame: str) -> Iterator[bytes]:
    """Yield a trajectory as JSON."""
    head = {"robot": robot, "frame": frame, "kind": "filtered", "map_version": stream.map_version}
    yield orjson.dumps(head)[:-1] + b',"poses":['
    separator = b""
    for piece in stream.pieces:
        rows = zip(piece.t.tolist(), piece.pose, piece.submap.tolist(), strict=True)
        body = orjson.dumps([{"t": t, **pose_answer(pose), "submap": k} for t, pose, k in rows])
        if len(body) > 2:
            yield separator + body[1:-1]
            separator = b","
    yield b"]}"


def as_tum(stream: Stream) -> Iterator[bytes]:
    """Yield a trajectory as lines ``t x y z qx qy qz qw``."""
    for piece in stream.pieces:
        lines = [f"{t!r} {tum_rest(pose)}\n" for t, pose in zip(piece.t.tolist(), piece.pose, strict=True)]
        if lines:
            yield "".join(lines).encode()
