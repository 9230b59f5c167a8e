"""The journal's binary form gives back what it was given, bit for bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays_of

from service.store.encoding import (
    EncodingError,
    decode_batch,
    decode_track,
    digest,
    encode_batch,
    encode_track,
    pack,
    unpack,
)
from submaps.measurements import Batch, Report

FLOATS = st.floats(width=64)


@st.composite
def any_batches(draw: st.DrawFn) -> Batch:
    """Draw a batch: its content need not make sense to a map."""
    n, m = draw(st.integers(1, 6)), draw(st.integers(0, 5))
    d, channels = draw(st.sampled_from([0, 2, 3, 6])), draw(st.integers(1, 4))
    c = draw(st.integers(0, 5)) if d else 0  # without motion there are no controls

    def numbers(*shape: int) -> Any:
        return draw(arrays_of.arrays(np.float64, shape, elements=FLOATS))

    def steps(count: int) -> Any:
        return draw(arrays_of.arrays(np.int64, count, elements=st.integers(0, 2**62)))

    return Batch(
        t=numbers(n), control_step=steps(c), control=numbers(d, c),
        control_covariance=numbers(c, d, d) if draw(st.booleans()) else None,
        observation_step=steps(m),
        landmark=tuple(draw(st.lists(st.text(min_size=1), min_size=m, max_size=m))),
        z=numbers(channels, m),
        observation_covariance=numbers(m, channels, channels) if draw(st.booleans()) else None,
    )  # fmt: skip


@given(any_batches())
def test_a_batch_comes_back_bit_for_bit(batch: Batch) -> None:
    again = decode_batch(encode_batch(batch))
    for name in (
        "t",
        "control_step",
        "control",
        "control_covariance",
        "observation_step",
        "z",
        "observation_covariance",
    ):
        before, after = getattr(batch, name), getattr(again, name)
        if before is None:
            assert after is None
            continue
        assert (after.dtype, after.shape, after.tobytes()) == (before.dtype, before.shape, before.tobytes())
        # Compiled code takes nothing else.
        assert after.flags.c_contiguous
        assert after.flags.writeable
        assert after.flags.aligned
    assert again.landmark == batch.landmark


@given(any_batches(), any_batches())
def test_a_digest_tells_batches_apart(one: Batch, other: Batch) -> None:
    same = encode_batch(one) == encode_batch(other)
    assert (digest(encode_batch(one)) == digest(encode_batch(other))) == same
    assert encode_batch(decode_batch(encode_batch(one))) == encode_batch(one)


@pytest.mark.parametrize("pose", [3, 6])
def test_a_track_comes_back_in_the_plane_and_in_space(pose: int) -> None:
    random = np.random.default_rng(pose)
    t, track, odom = np.arange(4.0), random.normal(size=(4, pose)), random.normal(size=(4, pose))
    report = Report(2, 3.0, tuple(track[-1].tolist()), (), (), np.array([0, 0, 1, 2], dtype=np.int32), track, odom)
    again = decode_track(encode_track(t, report))
    for found, given_ in ((again.t, t), (again.submap, report.track_submap), (again.pose, track), (again.odom, odom)):
        np.testing.assert_array_equal(found, given_)


def test_a_batch_as_it_was_written_before_there_was_space_is_read() -> None:
    """Header and arrays of a batch of the plane, as every journal so far holds them."""
    arrays = {
        "t": np.array([0.5]), "control_step": np.array([0]), "control": np.array([[1.0], [0.0], [0.1]]),
        "observation_step": np.array([0]), "z": np.array([[2.0], [3.0]]),
    }  # fmt: skip
    batch = decode_batch(pack("batch", arrays, landmark=["7"]))
    assert (batch.control.shape, batch.z.tolist(), batch.landmark) == ((3, 1), [[2.0], [3.0]], ("7",))
    assert encode_batch(batch) == pack("batch", arrays, landmark=("7",))


@given(st.data())
def test_broken_bytes_are_refused(data: st.DataObject) -> None:
    whole = pack("track", {"t": np.arange(5.0), "k": np.arange(5, dtype=np.int32)}, note="x")
    cut = data.draw(st.integers(0, len(whole) - 9))
    with pytest.raises(EncodingError):
        unpack("track", whole[:cut])
    with pytest.raises(EncodingError):
        unpack("batch", whole)
