"""The compiled kernel and the main path's observation models, as the references take them.

Everything in these folders that calls compiled functions of the main path calls them through here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from submaps._jit import jit
from submaps.filtering import kernel
from submaps.filtering.kernel import USED, add_rank_one, predict_invariant, predict_standard
from submaps.observation import models
from submaps.observation.models import MODELS
from submaps.reference.ekf import Estimate

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_augment, _update = kernel.augment, kernel.update


@dataclass(frozen=True)
class Compiled:
    """A planar observation model of the main path, by its name in a map's configuration."""

    name: str
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def number(self) -> int:
        """The kernel's number of the model."""
        return MODELS[self.name]

    @property
    def place(self) -> Floats:
        """The mount as the kernel takes it: (x m, y m, cos, sin)."""
        x, y, theta = self.mount
        return np.array([x, y, math.cos(theta), math.sin(theta)])

    def predict(self, y: Floats) -> tuple[Floats, Floats]:
        """h(y) and dh/dy."""
        found = models.predict(self.number, float(y[0]), float(y[1]), self.place)
        return np.array(found[:2]), np.array(found[2:]).reshape(2, 2)

    def invert(self, z: Floats) -> tuple[Floats, Floats]:
        """The body-frame point that a reading shows, and its derivative."""
        found = models.invert(self.number, float(z[0]), float(z[1]), self.place)
        return np.array(found[:2]), np.array(found[2:]).reshape(2, 2)

    def innovation(self, z: Floats, expected: Floats) -> Floats:
        """z - h, a bearing's difference the short way."""
        return np.array(
            models.innovation(self.number, float(z[0]), float(z[1]), float(expected[0]), float(expected[1]))
        )


@jit("void(float64[::1], float64[:, ::1], int64, float64[::1], float64[:, ::1], boolean, float64[:, ::1], int64)")
def _predict_often(
    x: Floats, P: Floats, n: int, increment: Floats, noise: Floats, invariant: bool, scratch: Floats, times: int
) -> None:
    for _ in range(times):
        if not invariant:
            predict_standard(x, P, n, increment, noise)
        elif predict_invariant(x, P, n, increment, noise, scratch[0]):
            add_rank_one(P, n, scratch[0])


@jit(
    "int64(float64[::1], float64[:, ::1], int64, int64[::1], int64, float64[::1], float64[:, ::1], float64[:, ::1],"
    " boolean, float64[:, ::1])"
)
def _update_each(
    x: Floats, P: Floats, n: int, slots: Ints, model: int, mount: Floats, z: Floats, R: Floats, invariant: bool,
    scratch: Floats,
) -> int:  # fmt: skip
    used = 0
    for i in range(slots.shape[0]):
        status, _ = _update(
            x, P, n, slots[i], model, mount, z[i, 0], z[i, 1], R, math.inf, math.inf, invariant, scratch[0], False,
            scratch[1], scratch[2],
        )  # fmt: skip
        used += status == USED
    return used


@jit("boolean(float64[::1], float64[:, ::1], int64, int64, float64[::1], float64[::1], float64[:, ::1], boolean)")
def _append(x: Floats, P: Floats, n: int, model: int, mount: Floats, z: Floats, R: Floats, invariant: bool) -> bool:
    return bool(_augment(x, P, n, model, mount, z[0], z[1], R, invariant))


class KernelFilter:
    """The compiled filter on arrays of its own, from any state: one pose, its landmarks, no sub-maps.

    Rows of P run to a multiple of eight, as the kernel's passes do.
    """

    def __init__(self, estimate: Estimate, model: Compiled, *, invariant: bool, landmarks: int) -> None:
        self._model, self._place, self._invariant = model.number, model.place, invariant
        self.size = int(estimate.x.shape[0])
        rows = -(-(self.size + 2 * landmarks) // 8) * 8
        self._x, self._P, self._scratch = np.zeros(rows), np.zeros((rows, rows)), np.zeros((3, rows))
        self._x[: self.size], self._P[: self.size, : self.size] = estimate.x, estimate.P

    @property
    def estimate(self) -> Estimate:
        """State and covariance now."""
        n = self.size
        return Estimate(self._x[:n].copy(), self._P[:n, :n].copy())

    @property
    def heading(self) -> float:
        """The heading (rad)."""
        return float(self._x[2])

    @property
    def heading_variance(self) -> float:
        """P of the heading (rad²)."""
        return float(self._P[2, 2])

    def predict(self, increment: Floats, noise: Floats, times: int = 1) -> None:
        """Move by a body-frame increment (3,), as many times."""
        _predict_often(self._x, self._P, self.size, increment, noise, self._invariant, self._scratch, times)

    def augment(self, z: Floats, R: Floats) -> int:
        """Append the landmark that a reading (2,) shows; its slot."""
        slot = self.size
        if not _append(self._x, self._P, slot, self._model, self._place, z, R, self._invariant):
            raise ValueError(f"a reading that shows a point was expected, got {z.tolist()}")
        self.size += 2
        return slot

    def update(self, slots: Ints, z: Floats, R: Floats) -> int:
        """Readings z (m, 2) of the landmarks at ``slots`` (m,), one after the other; how many were used."""
        return int(
            _update_each(
                self._x, self._P, self.size, slots, self._model, self._place, z, R, self._invariant, self._scratch
            )
        )  # fmt: skip
