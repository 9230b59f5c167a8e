"""The compiled kernel and the main path's observation models, as the references take them.

Everything in this folder that calls compiled functions of the main path's filter calls them through here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.config import ObservationConfig
from submaps.filtering import kernel
from submaps.filtering.kernel import USED
from submaps.filtering.passes import add
from submaps.filtering.predicting import predict_invariant, predict_standard
from submaps.filtering.workspace import workspace
from submaps.geometry.space import SPACES, Key, Space
from submaps.observation import models
from submaps.observation.models import MODELS, sensor_of
from submaps.reference.ekf import Estimate

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_augment, _update = kernel.augment, kernel.update


@dataclass(frozen=True)
class Compiled:
    """An observation model of the main path, as a map's configuration describes it."""

    config: ObservationConfig

    @property
    def space(self) -> Space:
        """The plane or space that it looks at."""
        return SPACES["se2" if len(self.config.mount) == 3 else "se3"]

    @property
    def number(self) -> int:
        """The kernel's number of the model."""
        return MODELS[self.config.model]

    @property
    def sensor(self) -> Floats:
        """The sensor as the kernel takes it."""
        return sensor_of(self.space, self.config)

    @property
    def R(self) -> Floats:
        """Covariance of a reading."""
        return np.diag(np.square(self.config.sigma))

    def predict(self, y: Floats) -> tuple[Floats, Floats]:
        """h(y) and dh/dy."""
        expected, slope = models.reading(self.space.key, self.number, self.sensor, np.array(y))
        return expected, slope

    def shown(self, z: Floats, R: Floats) -> tuple[Floats, Floats]:
        """The body-frame point that a reading shows, and its covariance."""
        point, covariance = models.shown(self.space.key, self.number, self.sensor, np.array(z), np.array(R))
        return point, covariance

    def innovation(self, z: Floats, expected: Floats) -> Floats:
        """z - h, a bearing's difference the short way."""
        v = z - expected
        for i, channel in enumerate(self.config.channels):
            if channel == "bearing":
                v[i] = math.remainder(v[i], 2.0 * math.pi)
        return np.asarray(v)


_STATE = "float64[::1], float64[:, ::1], int64, "
_KEYS = ("UniTuple(int64, 2), ", "UniTuple(int64, 3), ")


@jit(*("void(" + key + _STATE + "float64[::1], float64[:, ::1], boolean, float64[:, ::1], int64)" for key in _KEYS))
def _predict_often(
    space: Key, x: Floats, P: Floats, n: int, increment: Floats, noise: Floats, invariant: bool, scratch: Floats,
    times: int,
) -> None:  # fmt: skip
    U = scratch[: 2 * len(space) - 3]
    for _ in range(times):
        if not invariant:
            predict_standard(space, x, P, n, increment, noise)
        elif predict_invariant(space, x, P, n, increment, noise, U):
            add(space, P, n, U)


@jit(
    *(
        "int64(" + key + _STATE + "int64[::1], int64, float64[::1], float64[::1], float64[:, ::1], boolean,"
        " float64[:, ::1])"
        for key in _KEYS
    )
)  # fmt: skip
def _update_each(
    space: Key, x: Floats, P: Floats, n: int, slots: Ints, model: int, sensor: Floats, z: Floats, R: Floats,
    invariant: bool, scratch: Floats,
) -> int:  # fmt: skip
    rot, w, used = 2 * len(space) - 3, workspace(), 0
    U, A, channels = scratch[:rot], scratch[rot:], z.shape[0] // slots.shape[0]
    for i in range(slots.shape[0]):
        status, _ = _update(
            space, x, P, n, slots[i], model, sensor, 0, z, i * channels, R, math.inf, math.inf, invariant, U, False, A,
            False, w, w,
        )  # fmt: skip
        used += status == USED
    return used


@jit(
    *(
        "boolean(" + key + _STATE + "int64, float64[::1], float64[::1], float64[:, ::1], boolean)" for key in _KEYS
    )
)  # fmt: skip
def _append(
    space: Key, x: Floats, P: Floats, n: int, model: int, sensor: Floats, z: Floats, R: Floats, invariant: bool
) -> bool:
    return bool(_augment(space, x, P, n, model, sensor, 0, z, 0, R, invariant, workspace()))


class KernelFilter:
    """The compiled filter on arrays of its own, from any state: one pose, its landmarks, no sub-maps.

    Rows of P run to a multiple of eight, as the kernel's passes do.
    """

    def __init__(self, estimate: Estimate, model: Compiled, *, invariant: bool, landmarks: int) -> None:
        self.space = model.space
        self._model, self._sensor, self._invariant = model.number, model.sensor, invariant
        self.size = int(estimate.x.shape[0])
        rows = -(-(self.size + self.space.dim * landmarks) // 8) * 8
        self._x, self._P, self._scratch = np.zeros(rows), np.zeros((rows, rows)), np.zeros((self.space.pose, rows))
        self._x[: self.size], self._P[: self.size, : self.size] = estimate.x, estimate.P

    @property
    def estimate(self) -> Estimate:
        """State and covariance now."""
        n = self.size
        return Estimate(self._x[:n].copy(), self._P[:n, :n].copy())

    @property
    def rotation(self) -> Floats:
        """The heading (1,) or rotation vector (3,), rad."""
        return self._x[self.space.dim : self.space.pose].copy()

    @property
    def rotation_variance(self) -> Floats:
        """Its block of P, (1, 1) or (3, 3), rad²."""
        d, pose = self.space.dim, self.space.pose
        return self._P[d:pose, d:pose].copy()

    def predict(self, increment: Floats, noise: Floats, times: int = 1) -> None:
        """Move by a body-frame increment (pose,) with covariance (pose, pose), as many times."""
        _predict_often(
            self.space.key, self._x, self._P, self.size, increment, noise, self._invariant, self._scratch, times
        )

    def augment(self, z: Floats, R: Floats) -> int:
        """Append the landmark that a reading shows; its slot."""
        slot, state = self.size, (self._x, self._P, self.size)
        if not _append(self.space.key, *state, self._model, self._sensor, z, R, self._invariant):
            raise ValueError(f"a reading that shows a point was expected, got {z.tolist()}")
        self.size += self.space.dim
        return slot

    def update(self, slots: Ints, z: Floats, R: Floats) -> int:
        """Readings z (m, c) of the landmarks at ``slots`` (m,), one after the other; how many were used."""
        state = self._x, self._P, self.size
        used = _update_each(
            self.space.key, *state, slots, self._model, self._sensor, z.ravel(), R, self._invariant, self._scratch
        )
        return int(used)
