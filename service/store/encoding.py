"""Binary form of what the journal keeps: a JSON header and raw little-endian arrays, no pickle.

Layout: ``b"SMJ1"``, the header's length as uint32, the header (JSON, padded with spaces to a
multiple of 8), then each array's bytes in the header's order, each padded with zeros to a multiple
of 8. Equal content gives equal bytes, so a digest of the bytes is a digest of the content.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from submaps.measurements import Batch, Report

MAGIC = b"SMJ1"
_PREFIX = struct.Struct("<4sI")
_DTYPES = {"<f8", "<f4", "<i8", "<i4", "<i2", "|i1", "|u1", "|b1"}


class EncodingError(ValueError):
    """Bytes of the journal are not what this version writes."""


def pack(kind: str, arrays: Mapping[str, NDArray[Any]], **fields: Any) -> bytes:
    """Return named arrays and JSON fields as bytes."""
    table, parts = [], []
    for name, given in arrays.items():
        array, code = given, given.dtype.str
        if code not in _DTYPES:
            array = given.astype(given.dtype.newbyteorder("<"))
            code = array.dtype.str
        if code not in _DTYPES:
            raise EncodingError(f"{name}: cannot keep an array of {array.dtype}")
        table.append((name, code, array.shape))
        parts.append(array.tobytes())
        if array.nbytes % 8:
            parts.append(bytes(-array.nbytes % 8))
    header = orjson.dumps({"kind": kind, "arrays": table, **fields})
    header += b" " * (-len(header) % 8)
    return b"".join([_PREFIX.pack(MAGIC, len(header)), header, *parts])


def unpack(kind: str, data: bytes) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return the fields and the arrays of ``pack``; the arrays are writable copies."""
    try:
        magic, length = _PREFIX.unpack_from(data)
        if magic != MAGIC:
            raise EncodingError(f"starts with {magic!r}, expected {MAGIC!r}")
        header = orjson.loads(data[_PREFIX.size : _PREFIX.size + length])
        if header["kind"] != kind:
            raise EncodingError(f"holds {header['kind']!r}, expected {kind!r}")
        return header, _arrays(header["arrays"], data, _PREFIX.size + length)
    except (struct.error, orjson.JSONDecodeError, KeyError, TypeError) as error:
        raise EncodingError(f"cannot be read as {kind!r}: {error}") from error


def _arrays(table: list[Any], data: bytes, offset: int) -> dict[str, NDArray[Any]]:
    arrays = {}
    for name, dtype, shape in table:
        if dtype not in _DTYPES:
            raise EncodingError(f"{name}: unknown type {dtype!r}")
        count = int(np.prod(shape, dtype=np.int64))
        width = np.dtype(dtype).itemsize * count
        if offset + width > len(data):
            raise EncodingError(f"{name}: {len(data) - offset} bytes left, expected {width}")
        # Copied: compiled code knows writable arrays only, and native byte order.
        raw = np.frombuffer(data, dtype, count, offset)
        arrays[name] = raw.astype(raw.dtype.newbyteorder("="), copy=True).reshape(shape)
        offset += width + -width % 8
    return arrays


def digest(data: bytes) -> bytes:
    """Return the digest of encoded content, 32 bytes."""
    return hashlib.sha256(data).digest()


def encode_batch(batch: Batch) -> bytes:
    """Return a batch as bytes; equal batches give equal bytes."""
    arrays: dict[str, NDArray[Any]] = {
        "t": batch.t,
        "control_step": batch.control_step,
        "control": batch.control,
        "observation_step": batch.observation_step,
        "z": batch.z,
    }
    if batch.control_covariance is not None:
        arrays["control_covariance"] = batch.control_covariance
    if batch.observation_covariance is not None:
        arrays["observation_covariance"] = batch.observation_covariance
    return pack("batch", arrays, landmark=batch.landmark)


def decode_batch(data: bytes) -> Batch:
    """Return the batch that ``encode_batch`` was given."""
    fields, arrays = unpack("batch", data)
    return Batch(
        t=arrays["t"],
        control_step=arrays["control_step"],
        control=arrays["control"],
        control_covariance=arrays.get("control_covariance"),
        observation_step=arrays["observation_step"],
        landmark=tuple(fields["landmark"]),
        z=arrays["z"],
        observation_covariance=arrays.get("observation_covariance"),
    )


@dataclass(frozen=True)
class Track:
    """Poses of a batch at ``t`` (n,) s: filtered (n, 3) in the frame of ``submap`` (n,), and in ``odom``."""

    t: NDArray[np.float64]
    submap: NDArray[np.int32]
    pose: NDArray[np.float64]
    odom: NDArray[np.float64]


def encode_track(t: NDArray[np.float64], report: Report) -> bytes:
    """Return the track of a batch as bytes."""
    arrays: dict[str, NDArray[Any]] = {
        "t": t,
        "submap": report.track_submap,
        "pose": report.track_pose,
        "odom": report.track_odom,
    }
    return pack("track", arrays)


def decode_track(data: bytes) -> Track:
    """Return the track that ``encode_track`` was given."""
    _, arrays = unpack("track", data)
    return Track(arrays["t"], arrays["submap"], arrays["pose"], arrays["odom"])
