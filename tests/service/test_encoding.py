"""The journal's binary form gives back what it was given, bit for bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays_of

from service.store.encoding import EncodingError, decode_batch, digest, encode_batch, pack, unpack
from submaps.measurements import Batch

FLOATS = st.floats(width=64)


@st.composite
def any_batches(draw: st.DrawFn) -> Batch:
    """Draw a batch: its content need not make sense to a map."""
    n, c, m = draw(st.integers(1, 6)), draw(st.integers(0, 5)), draw(st.integers(0, 5))
    d = draw(st.integers(2, 3))

    def numbers(*shape: int) -> Any:
        return draw(arrays_of.arrays(np.float64, shape, elements=FLOATS))

    def steps(count: int) -> Any:
        return draw(arrays_of.arrays(np.int64, count, elements=st.integers(0, 2**62)))

    return Batch(
        t=numbers(n), control_step=steps(c), control=numbers(d, c),
        control_covariance=numbers(c, d, d) if draw(st.booleans()) else None,
        observation_step=steps(m),
        landmark=tuple(draw(st.lists(st.text(min_size=1), min_size=m, max_size=m))),
        z=numbers(2, m),
        observation_covariance=numbers(m, 2, 2) if draw(st.booleans()) else None,
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


@given(st.data())
def test_broken_bytes_are_refused(data: st.DataObject) -> None:
    whole = pack("track", {"t": np.arange(5.0), "k": np.arange(5, dtype=np.int32)}, note="x")
    cut = data.draw(st.integers(0, len(whole) - 9))
    with pytest.raises(EncodingError):
        unpack("track", whole[:cut])
    with pytest.raises(EncodingError):
        unpack("batch", whole)
