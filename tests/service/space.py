"""A small world in space to send to a service: a robot that climbs and dips in circles among landmarks."""

from __future__ import annotations

import json
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.wire.base import parse
from service.wire.maps import MAP_REQUEST
from submaps.config import MapConfig
from submaps.geometry.space import SOLID, Pose
from tests.service.support import ODOMETRY_MAP, Json

Floats = NDArray[np.float64]

ODOMETRY_SIGMA, POINT_SIGMA, PIXEL_SIGMA = [0.01, 0.01, 0.01, 0.002, 0.002, 0.002], 0.05, 0.5
MOTION: Json = {"model": "odometry3d", "sigma": ODOMETRY_SIGMA}
NO_MOTION: Json = {"model": "none"}
# Looks ahead: the camera's z is the body's x.
AHEAD = [0.1, 0.0, 0.2, -0.5, 0.5, -0.5, 0.5]
CAMERA = {"fu": 400.0, "fv": 410.0, "cu": 320.0, "cv": 240.0}
POINTS: Json = {"model": "cartesian3d", "sigma": [POINT_SIGMA] * 3, "mount": [0.0, 0.1, 0.3, 0.0, 0.0, 0.6, 0.8]}
STEREO: Json = {"model": "stereo", "sigma": [PIXEL_SIGMA] * 4, "mount": AHEAD, "camera": CAMERA | {"baseline": 0.3}}
PINHOLE: Json = {
    "model": "pinhole", "sigma": [4.0 * PIXEL_SIGMA] * 2, "mount": AHEAD, "camera": CAMERA,
    "depth": {"mean": 4.0, "sigma": 1.5},
}  # fmt: skip
BEARING_MAP: Json = {
    "motion": ODOMETRY_MAP["motion"],
    "observation": {"model": "bearing", "sigma": [0.02], "depth": {"mean": 8.0, "sigma": 4.0}},
}
CHANNELS = {
    "cartesian3d": ("x", "y", "z"),
    "stereo": ("u_left", "v_left", "u_right", "v_right"),
    "pinhole": ("u", "v"),
}
CONTROL = ("dx", "dy", "dz", "rx", "ry", "rz")
RADIUS, LAP, REACH = 6.0, 60, 5.0


def space_map(observation: Json, motion: Json = MOTION, **submap: float) -> Json:
    """The body that makes a map in space."""
    bounds = {"max_landmarks": 12, "max_heading_sigma": 0.05, "max_position_sigma": 0.3, **submap}
    return {"space": "se3", "motion": motion, "observation": observation, "submap": bounds}


SPACE = space_map(POINTS)


def core_of(config: Json) -> MapConfig:
    """The estimator's configuration of a map."""
    return parse(MAP_REQUEST, json.dumps(config).encode()).to_core()


def without(body: Json, *names: str) -> Json:
    """A body less some of its fields."""
    return {name: value for name, value in body.items() if name not in names}


def pose_at(k: int) -> Pose:
    """The true pose at step k, in the world: round a circle, up and down, rolling a little."""
    turn = 2.0 * np.pi * k / LAP
    ahead = SOLID.exp((0.0, 0.0, 0.0, 0.0, 0.0, turn + 0.5 * np.pi))
    tilt = SOLID.exp((0.0, 0.0, 0.0, 0.15 * np.sin(3.0 * turn), 0.2 * np.cos(2.0 * turn), 0.0))
    rotation = SOLID.compose(ahead, tilt)[3:]
    return (RADIUS * np.cos(turn), RADIUS * np.sin(turn), 0.8 * np.sin(2.0 * turn), *rotation)


def truth(count: int, origin: int = 0) -> list[Pose]:
    """The true poses after each step, in the frame of the pose at step ``origin``."""
    return [SOLID.between(pose_at(origin), pose_at(k + 1)) for k in range(count)]


@cache
def landmarks() -> Floats:
    """(40, 3) points about the circle, m."""
    random = np.random.default_rng(11)
    angle = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    radius = RADIUS + np.where(np.arange(40) % 2, 2.0, -2.0) + random.uniform(-0.4, 0.4, 40)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), random.uniform(-1.5, 1.5, 40)])


def mount_of(observation: Json) -> Pose:
    """The sensor's pose in the body."""
    x, y, z, *q = observation["mount"]
    half = np.arctan2(np.linalg.norm(q[:3]), q[3])
    axis = np.array(q[:3]) / max(float(np.linalg.norm(q[:3])), 1e-12)
    return (x, y, z, *(2.0 * half * axis).tolist())


def reading(observation: Json, points: Floats) -> Floats:
    """What the sensor says of points (n, 3) in its frame, without noise: (n, channels)."""
    if observation["model"] == "cartesian3d":
        return points
    camera = observation["camera"]
    x, y, z = points.T
    u, v = camera["fu"] * x / z + camera["cu"], camera["fv"] * y / z + camera["cv"]
    if observation["model"] == "pinhole":
        return np.column_stack([u, v])
    return np.column_stack([u, v, u - camera["fu"] * camera["baseline"] / z, v])


def steps(count: int, observation: Json, seed: int = 0, *, odometry: bool = True) -> list[Json]:
    """Steps of the robot; a camera sees what is 1 m and more ahead, inside its picture."""
    random = np.random.default_rng(seed)
    mount, made = mount_of(observation), []
    for k in range(count):
        before, now = pose_at(k), pose_at(k + 1)
        moved = np.array(SOLID.between(before, now)) + random.normal(size=6) * ODOMETRY_SIGMA
        sensor = SOLID.compose(now, mount)
        points = SOLID.transform(SOLID.inverse(sensor), landmarks())
        near = np.linalg.norm(points, axis=1) < REACH
        if observation["model"] != "cartesian3d":
            near = (points[:, 2] > 1.0) & (points[:, 2] < 8.0) & np.all(np.abs(points[:, :2]) < points[:, 2:], axis=1)
        seen = np.flatnonzero(near)
        z = reading(observation, points[seen])
        z = z + random.normal(size=z.shape) * observation["sigma"]
        step: Json = {"t": round(0.1 * (k + 1), 6)}
        if odometry:
            step["odometry"] = dict(zip(CONTROL, moved.tolist(), strict=True))
        step["observations"] = [
            {"landmark": str(i), **dict(zip(CHANNELS[observation["model"]], row, strict=True))}
            for i, row in zip(seen.tolist(), z.tolist(), strict=True)
        ]
        made.append(step)
    return made


def batches(count: int, size: int, observation: Json, **options: Any) -> list[Json]:
    """``count`` batches of ``size`` steps each, as rows."""
    made = steps(count * size, observation, **options)
    return [{"sequence": i + 1, "steps": made[i * size : (i + 1) * size]} for i in range(count)]


def as_columns(rows: Json, observation: Json) -> Json:
    """A batch of rows as columns; each of its steps has an odometry, or none has."""
    seen = [(k, o) for k, step in enumerate(rows["steps"]) for o in step["observations"]]
    body: Json = {"sequence": rows["sequence"], "t": [step["t"] for step in rows["steps"]]}
    if "odometry" in rows["steps"][0]:
        body["control"] = [[step["odometry"][name] for step in rows["steps"]] for name in CONTROL]
    names = CHANNELS[observation["model"]]
    body["observation"] = {
        "step": [k for k, _ in seen],
        "landmark": [o["landmark"] for _, o in seen],
        "z": [[o[name] for _, o in seen] for name in names],
    }
    return body


def is_unit(quaternion: list[float]) -> bool:
    """Whether a quaternion is as answers have it: of length 1, w not below 0."""
    return bool(abs(np.linalg.norm(quaternion) - 1.0) < 1e-12 and quaternion[3] >= 0.0)
