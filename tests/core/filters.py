"""Dense references for the filter in the plane and in space, written from the definitions, and the compiled one.

Nothing in the references uses the package's own filter: Jacobians are numeric, rotations SciPy's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from submaps.config import Camera, Depth, ObservationConfig
from submaps.consistency import chi_square_bound
from submaps.filtering.closing import Shelf, flush
from submaps.filtering.layout import DIM, DONE
from submaps.filtering.walk import walk
from submaps.geometry.space import PLANE, SOLID, Space
from submaps.observation.models import MODELS, body_sensor, sensor_of
from submaps.submap import ActiveSubmap
from tests.core.support import R as plane_rotation
from tests.core.support import V as plane_left_jacobian
from tests.core.support import jacobian, wrapped

Floats = NDArray[np.float64]
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(20)
_CAMERA = {"fu": 480.0, "fv": 470.0, "cu": 320.0, "cv": 240.0}
_MOUNT = (0.7, -0.3, 0.4)
_SOLID_MOUNT = (0.2, -0.1, 0.3, *Rotation.from_rotvec([0.2, 1.4, -0.3]).as_quat())

# One row for each model: how it is mounted, and the size of its noise.
SENSORS = {
    "cartesian": ObservationConfig("cartesian", (0.1, 0.1), _MOUNT),
    "range_bearing": ObservationConfig("range_bearing", (0.1, 0.1), _MOUNT),
    "bearing": ObservationConfig("bearing", (0.1,), _MOUNT, depth=Depth(7.0, 2.0)),
    "cartesian3d": ObservationConfig("cartesian3d", (0.1,) * 3, _SOLID_MOUNT),
    "stereo": ObservationConfig("stereo", (1.0,) * 4, _SOLID_MOUNT, Camera(**_CAMERA, baseline=0.25)),
    "pinhole": ObservationConfig("pinhole", (1.0,) * 2, _SOLID_MOUNT, Camera(**_CAMERA), Depth(6.0, 1.5)),
}


def space_of(sensor: ObservationConfig) -> Space:
    """The plane or space that a sensor looks at."""
    return PLANE if len(sensor.mount) == 3 else SOLID


def rotation(space: Space, angles: Floats) -> Floats:
    """Rotation matrix of a heading (1,) or a rotation vector (3,)."""
    return plane_rotation(float(angles[0])) if space.dim == 2 else np.asarray(Rotation.from_rotvec(angles).as_matrix())


def left_jacobian(space: Space, angles: Floats) -> Floats:
    """The mean of the rotations from nothing to ``angles``, by Gauss-Legendre quadrature."""
    if space.dim == 2:
        return plane_left_jacobian(float(angles[0]))
    on_the_way = Rotation.from_rotvec(np.outer(0.5 * (1.0 + _NODES), angles)).as_matrix()
    return np.asarray(np.tensordot(0.5 * _WEIGHTS, on_the_way, axes=1))


def turned(space: Space, e: Floats, angles: Floats) -> Floats:
    """The rotation exp(e) exp(angles)."""
    if space.dim == 2:
        return np.asarray(angles + e)
    return np.asarray((Rotation.from_rotvec(e) * Rotation.from_rotvec(angles)).as_rotvec())


def places(space: Space, x: Floats) -> list[int]:
    """Where the position and the landmarks begin."""
    return [0, *range(space.pose, x.shape[0], space.dim)]


def plus(space: Space, x: Floats, xi: Floats, invariant: bool) -> Floats:
    """The state (p, rotation, l_1, ...) moved by an error of the filter."""
    d, p = space.dim, space.pose
    out = x + xi
    if invariant:
        E, V = rotation(space, xi[d:p]), left_jacobian(space, xi[d:p])
        for j in places(space, x):
            out[j : j + d] = E @ x[j : j + d] + V @ xi[j : j + d]
    out[d:p] = turned(space, xi[d:p], x[d:p])
    return out


def minus(space: Space, x: Floats, base: Floats, invariant: bool) -> Floats:
    """The error that takes ``base`` to ``x``."""
    d, p = space.dim, space.pose
    xi = x - base
    xi[d:p] = turned(space, x[d:p], -base[d:p])
    if space.dim == 2:
        xi[2] = wrapped(xi[2])
    if invariant:
        E, V = rotation(space, xi[d:p]), left_jacobian(space, xi[d:p])
        for j in places(space, x):
            xi[j : j + d] = np.linalg.solve(V, x[j : j + d] - E @ base[j : j + d])
    return xi


def after(space: Space, pose: Floats, increment: Floats) -> Floats:
    """Pose composed with a body-frame increment."""
    d = space.dim
    position = pose[:d] + rotation(space, pose[d : space.pose]) @ increment[:d]
    return np.concatenate([position, turned(space, pose[d : space.pose], increment[d:])])


def _mount(sensor: ObservationConfig) -> tuple[Floats, Floats]:
    mount = np.array(sensor.mount)
    if len(mount) == 3:
        return mount[:2], plane_rotation(mount[2])
    return mount[:3], np.asarray(Rotation.from_quat(mount[3:]).as_matrix())


def seen(sensor: ObservationConfig, x: Floats, slot: int) -> Floats:
    """The reading of a landmark in the state, without noise."""
    space, (m, Rm) = space_of(sensor), _mount(sensor)
    d = space.dim
    body = rotation(space, x[d : space.pose]).T @ (x[slot : slot + d] - x[:d])
    s = Rm.T @ (body - m)
    if sensor.model.startswith("cartesian"):
        return np.asarray(s)
    if sensor.model == "range_bearing":
        return np.array([np.hypot(*s), np.arctan2(s[1], s[0])])
    if sensor.model == "bearing":
        return np.array([np.arctan2(s[1], s[0])])
    k = sensor.camera
    assert k is not None
    u, v = k.fu * s[0] / s[2] + k.cu, k.fv * s[1] / s[2] + k.cv
    return np.array([u, v]) if sensor.model == "pinhole" else np.array([u, v, u - k.fu * k.baseline / s[2], v])


def difference(sensor: ObservationConfig, a: Floats, b: Floats) -> Floats:
    """a - b, bearings the short way."""
    out = a - b
    if sensor.model in ("range_bearing", "bearing"):
        out[-1] = wrapped(out[-1])
    return out


def shown(sensor: ObservationConfig, x: Floats, z: Floats) -> Floats:
    """The landmark that a reading, with a depth after it where it has none, shows from the pose in the state."""
    space, (m, Rm) = space_of(sensor), _mount(sensor)
    k = sensor.camera
    if sensor.model.startswith("cartesian"):
        s = z
    elif sensor.model == "range_bearing":
        s = z[0] * np.array([np.cos(z[1]), np.sin(z[1])])
    elif sensor.model == "bearing":
        s = z[1] * np.array([np.cos(z[0]), np.sin(z[0])])
    else:
        assert k is not None
        depth = z[2] if sensor.model == "pinhole" else k.fu * k.baseline / (z[0] - z[2])
        v = z[1] if sensor.model == "pinhole" else 0.5 * (z[1] + z[3])
        s = depth * np.array([(z[0] - k.cu) / k.fu, (v - k.cv) / k.fv, 1.0])
    return np.asarray(x[: space.dim] + rotation(space, x[space.dim : space.pose]) @ (m + Rm @ s))


def with_prior(sensor: ObservationConfig, z: Floats, noise: Floats) -> tuple[Floats, Floats]:
    """A reading and its noise, with the depth's prior after it where there is one."""
    if sensor.depth is None:
        return z, noise
    whole = np.zeros((z.shape[0] + 1, z.shape[0] + 1))
    whole[:-1, :-1], whole[-1, -1] = noise, sensor.depth.sigma**2
    return np.append(z, sensor.depth.mean), whole


@dataclass
class DenseFilter:
    """An EKF in either error by numeric Jacobians and dense algebra, nothing clever."""

    x: Floats
    P: Floats
    invariant: bool
    sensor: ObservationConfig

    @property
    def space(self) -> Space:
        return space_of(self.sensor)

    def predict(self, increment: Floats, noise: Floats) -> None:
        """Through a body-frame increment whose error e moves it to ``plus``: position added, exp(e) R."""
        space, x, n, p = self.space, self.x, self.x.shape[0], self.space.pose
        new = np.concatenate([after(space, x, increment), x[p:]])

        def error(both: Floats) -> Floats:
            true = plus(space, x, both[:n], self.invariant)
            step = plus(space, increment, both[n:], False)
            return minus(space, np.concatenate([after(space, true, step), true[p:]]), new, self.invariant)

        J = jacobian(error, np.zeros(n + p))
        self.x, self.P = new, J[:, :n] @ self.P @ J[:, :n].T + J[:, n:] @ noise @ J[:, n:].T

    def update(self, slot: int, z: Floats, noise: Floats) -> float:
        """By one observation; the normalised innovation squared."""
        x, n = self.x, self.x.shape[0]
        expected = seen(self.sensor, x, slot)

        def predicted(xi: Floats) -> Floats:
            return difference(self.sensor, seen(self.sensor, plus(self.space, x, xi, self.invariant), slot), expected)

        H = jacobian(predicted, np.zeros(n))
        v = difference(self.sensor, z, expected)
        S = H @ self.P @ H.T + noise
        K = np.linalg.solve(S, H @ self.P).T
        self.x = plus(self.space, x, K @ v, self.invariant)
        self.P = self.P - K @ S @ K.T
        return float(v @ np.linalg.solve(S, v))

    def augment(self, z: Floats, noise: Floats) -> None:
        """By the landmark that a reading shows."""
        x, n, space = self.x, self.x.shape[0], self.space
        z, noise = with_prior(self.sensor, z, noise)
        new = np.concatenate([x, shown(self.sensor, x, z)])

        def error(both: Floats) -> Floats:
            true = plus(space, x, both[:n], self.invariant)
            point = shown(self.sensor, true, z + both[n:])
            return minus(space, np.concatenate([true, point]), new, self.invariant)

        J = jacobian(error, np.zeros(n + z.shape[0]))
        self.x, self.P = new, J[:, :n] @ self.P @ J[:, :n].T + J[:, n:] @ noise @ J[:, n:].T


class Kernel:
    """One sub-map driven through the compiled walk, step by step, without genesis."""

    def __init__(self, invariant: bool, sensor: ObservationConfig, gate: float = math.inf) -> None:
        self.space = space_of(sensor)
        self.submap = ActiveSubmap(0, 0, 0.0, 40, self.space)
        self.invariant = invariant
        self.channels = len(sensor.channels)
        self._slots = np.full(64, -1, dtype=np.int32)
        self._whole = np.array([MODELS[sensor.model], int(invariant), 1000, 1, 0], dtype=np.int64)
        bounds = [gate, chi_square_bound(0.9999, self.channels), math.inf, math.inf]
        self._real = np.concatenate([bounds, sensor_of(self.space, sensor), body_sensor(self.space)])

    def set(self, x: Floats, P: Floats) -> None:
        """Start from a state; landmarks are numbered from 0."""
        s, n = self.submap, x.shape[0]
        s.x[:n], s.P[:n, :n], s.counts[DIM] = x, P, n
        slots = np.arange(self.space.pose, n, self.space.dim)
        s.ids[: slots.shape[0]], self._slots[: slots.shape[0]] = np.arange(slots.shape[0]), slots

    def step(
        self, increment: Floats | None, noise: Floats | None, sightings: list[tuple[int, Floats]], R: Floats
    ) -> tuple[list[int], list[float]]:
        """One step; status and normalised innovation squared of each observation."""
        s, count, pose = self.submap, len(sightings), self.space.pose
        controls = 0 if increment is None else 1
        status, nis = np.full(count, 99, dtype=np.uint8), np.empty(count)
        z = np.ascontiguousarray(np.array([z for _, z in sightings]).reshape(-1, self.channels).T)
        shelf = Shelf(1, 1)
        event, last = walk(
            self.space.key, 0, False, np.zeros((controls, pose)) + (0.0 if increment is None else increment),
            np.zeros((controls, pose, pose)) + (0.0 if noise is None else noise), np.zeros(controls, dtype=np.int64),
            np.zeros(count, dtype=np.int64), np.array([i for i, _ in sightings], dtype=np.int64), z, R[np.newaxis],
            np.zeros(count, dtype=np.uint8), self._whole, self._real, s.x, s.P, s.ids, s.counts, s.motion, self._slots,
            s.scratch, nis, status, np.empty((1, pose)), np.empty(1, dtype=np.int32),
            shelf.whole, shelf.reals, shelf.ids, shelf.fill,
        )  # fmt: skip
        assert (event, last) == (DONE, 1)
        return [int(v) for v in status], [float(v) for v in nis]

    def predict(self) -> None:
        """Take the pending increment into the state."""
        s = self.submap
        flush(self.space.key, s.x, s.P, s.counts, s.motion, self.invariant, s.scratch)

    @property
    def x(self) -> Floats:
        return self.submap.x[: self.submap.dimension].copy()

    @property
    def P(self) -> Floats:
        n = self.submap.dimension
        return self.submap.P[:n, :n].copy()
