"""Work that tests hand to an experiment's workers, who import it by name."""

from __future__ import annotations

import os

import numpy as np


def multiply(seed: np.random.SeedSequence) -> bytes:
    """A product large enough for BLAS to share out among threads, bit for bit."""
    one, other = np.random.default_rng(seed).normal(size=(2, 300, 300))
    return np.asarray(one @ other).tobytes()


def threads(_: int) -> str | None:
    """How many threads a worker's BLAS was told to use."""
    return os.environ.get("OPENBLAS_NUM_THREADS")


def refuse(number: int) -> int:
    """Fails on 3."""
    if number == 3:
        raise ValueError("three")
    return number


def vanish(number: int) -> int:
    """Ends its process on 2, as the system does when memory runs out."""
    if number == 2:
        os._exit(9)
    return number
