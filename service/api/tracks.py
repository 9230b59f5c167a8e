"""A robot's trajectory as a stream: one piece for each batch that the journal holds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain

import numpy as np
import orjson
from numpy.typing import NDArray

from service.hosted import Hosted
from service.store.base import Journal
from service.store.encoding import decode_track
from submaps.atlas.view import View

Pose = tuple[float, float, float]


@dataclass(frozen=True)
class Piece:
    """Poses (n, 3) in the frame asked for, at times (n,) s, each from the filter of a sub-map (n,)."""

    t: NDArray[np.float64]
    submap: NDArray[np.int32]
    pose: NDArray[np.float64]


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
    pieces = (_piece(data, view, frame, frames, span) for data in chain([first], kept))
    return Stream(view.version, chain([next(pieces)], pieces))


def _piece(data: bytes, view: View, frame: str, frames: dict[int, Pose], span: tuple[float, float]) -> Piece:
    track = decode_track(data)
    within = (track.t >= span[0]) & (track.t <= span[1])
    submap, pose = track.submap[within], track.pose[within]
    if frame == "odom":
        return Piece(track.t[within], submap, track.odom[within])
    for k in set(submap.tolist()) - frames.keys():
        frames[k] = view.frame_in(k, frame)
    x, y, theta = np.array([frames[k] for k in submap.tolist()]).reshape(-1, 3).T
    cosine, sine = np.cos(theta), np.sin(theta)
    heading = theta + pose[:, 2]
    there = np.column_stack([
        x + cosine * pose[:, 0] - sine * pose[:, 1],
        y + sine * pose[:, 0] + cosine * pose[:, 1],
        np.arctan2(np.sin(heading), np.cos(heading)),
    ])  # fmt: skip
    return Piece(track.t[within], submap, there)


def as_json(stream: Stream, robot: str, frame: str) -> Iterator[bytes]:
    """Yield a trajectory as JSON."""
    head = {"robot": robot, "frame": frame, "kind": "filtered", "map_version": stream.map_version}
    yield orjson.dumps(head)[:-1] + b',"poses":['
    separator = b""
    for piece in stream.pieces:
        rows = zip(piece.t.tolist(), piece.pose.tolist(), piece.submap.tolist(), strict=True)
        body = orjson.dumps([
            {"t": t, "x": x, "y": y, "theta": theta, "submap": k} for t, (x, y, theta), k in rows
        ])  # fmt: skip
        if len(body) > 2:
            yield separator + body[1:-1]
            separator = b","
    yield b"]}"


def as_tum(stream: Stream) -> Iterator[bytes]:
    """Yield a trajectory as lines ``t x y z qx qy qz qw``."""
    for piece in stream.pieces:
        lines = [
            f"{t!r} {x!r} {y!r} 0 0 0 {np.sin(theta / 2):.17g} {np.cos(theta / 2):.17g}\n"
            for t, (x, y, theta) in zip(piece.t.tolist(), piece.pose.tolist(), strict=True)
        ]
        if lines:
            yield "".join(lines).encode()
