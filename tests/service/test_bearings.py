"""A map made of bearings alone, over HTTP: a prior on depth begins each landmark, the drive finds it."""

from __future__ import annotations

import math
import uuid
from contextlib import closing

import numpy as np

from submaps.alignment import align
from tests.service.space import BEARING_MAP
from tests.service.support import ODOMETRY_MAP, Api, Json, Server, steps

SIGMA = 0.03  # rad; much below it, a bearing that turns by half a radian a step outdoes the first order
DEPTH: Json = {"mean": 2.5, "sigma": 0.5}
CONFIG: Json = {
    "motion": {"model": "odometry", "sigma": [0.02, 0.01, 0.004]},
    "observation": {"model": "bearing", "sigma": [SIGMA], "depth": DEPTH},
    "submap": {"max_landmarks": 24, "max_heading_sigma": 0.05, "max_position_sigma": 0.5},
}  # fmt: skip


def bearings(count: int, seed: int = 0) -> list[Json]:
    """Steps of the robot of ``support.steps`` that sees directions only, and nothing nearer than 1 m."""
    random = np.random.default_rng(seed)
    made = []
    for step in steps(count, seed):
        seen = [
            {"landmark": one["landmark"], "bearing": math.atan2(one["y"], one["x"]) + SIGMA * random.normal()}
            for one in step["observations"]
            if math.hypot(one["x"], one["y"]) > 1.0
        ]
        made.append(step | {"observations": seen})
    return made


def test_landmarks_are_where_cartesian_readings_would_put_them(server: Server) -> None:
    names = [f"m{uuid.uuid4().hex[:12]}" for _ in range(2)]
    with (
        closing(Api(server.url, names[0]).make(CONFIG)) as api,
        closing(Api(server.url, names[1]).make(ODOMETRY_MAP)) as by,
    ):
        api.send({"sequence": 1, "steps": bearings(120)})
        by.send({"sequence": 1, "steps": steps(120)})
        found = []
        for one in (api, by):
            one.optimize()
            found.append({m["id"]: (m["x"], m["y"]) for m in one.all_of("landmarks")})
        assert found[0].keys() == found[1].keys()
        off = align(*(np.array([of[name] for name in found[1]]) for of in found))
        assert off.rmse < 0.5


def test_a_first_bearing_puts_a_landmark_at_the_priors_depth(server: Server) -> None:
    """Along the range sigma is the prior's, across it depth times the bearing's, to first order."""
    with closing(Api(server.url, f"m{uuid.uuid4().hex[:12]}").make(BEARING_MAP)) as api:
        assert api.get("")["config"]["observation"] == BEARING_MAP["observation"] | {"mount": [0.0] * 3}
        api.send({"sequence": 1, "steps": [{"t": 1.0, "observations": [{"landmark": "a", "bearing": 0.5}]}]})
        (one,) = api.all_of("landmarks")
        along = np.array([math.cos(0.5), math.sin(0.5)])
        across = np.array([-along[1], along[0]])
        np.testing.assert_allclose([one["x"], one["y"]], 8.0 * along, atol=1e-12)
        covariance = np.array(one["covariance"])
        np.testing.assert_allclose(
            [along @ covariance @ along, across @ covariance @ across], [16.0, (8.0 * 0.02) ** 2]
        )
