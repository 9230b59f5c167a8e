"""A start that cannot be is refused, and the refusal names its field."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from submaps.config import Start
from submaps.errors import ConfigError
from tests.core.support import random_covariance

Rows = tuple[tuple[float, float, float], ...]
GOOD = Start("submap/12", (1.0, -2.0, 0.5), ((0.25, 0.1, 0.0), (0.1, 0.25, -0.01), (0.0, -0.01, 0.01)))


def diagonal(a: float, b: float, c: float) -> Rows:
    """Rows of a diagonal matrix."""
    return (a, 0.0, 0.0), (0.0, b, 0.0), (0.0, 0.0, c)


@pytest.mark.parametrize(("field", "value"), [
    ("frame", "odom"),
    ("frame", "submap/"),
    ("frame", "submap/-1"),
    ("frame", "map "),
    ("pose", (1.0, 2.0)),
    ("pose", (1.0, math.nan, 0.0)),
    ("covariance", diagonal(1.0, 1.0, 1.0)[:2]),
    ("covariance", ((1.0, 0.0), (0.0, 1.0), (0.0, 0.0))),
    ("covariance", diagonal(1.0, math.inf, 1.0)),
    ("covariance", diagonal(1.0, 0.0, 1.0)),
    ("covariance", diagonal(1.0, 1.0, -1.0)),
    ("covariance", ((1.0, 2.0, 0.0), (2.0, 1.0, 0.0), (0.0, 0.0, 1.0))),
    ("covariance", ((1.0, 0.1, 0.0), (0.2, 1.0, 0.0), (0.0, 0.0, 1.0))),
    ("covariance", ((1.0,) * 3,) * 3),
])  # fmt: skip
def test_a_start_that_cannot_be_is_refused(field: str, value: Any) -> None:
    with pytest.raises(ConfigError) as refused:
        replace(GOOD, **{field: value})
    assert refused.value.field == f"start.{field}"


def test_any_covariance_will_do_for_a_start() -> None:
    rng = np.random.default_rng(0)
    for scale in (1e-6, 1.0, 1e4):
        a, b, c = random_covariance(rng, 3, scale).tolist()
        assert replace(GOOD, covariance=(tuple(a), tuple(b), tuple(c))).frame == "submap/12"
