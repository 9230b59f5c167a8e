"""The phantom update: a vehicle that stands still learns its heading from landmarks, where nothing was to be learned.

The vehicle's position is certain, its heading psi has the variance s² (rad²). A reading (r0, b0) of noise
diag(a², c²) makes a landmark; later, other readings have moved the estimate of the landmark to where it
would be read as (r, b). With D = b - b0, u and n the directions along and across the reading,
P_l,psi = s² r0 n0 and P_ll = (s² + c²) r0² n0 n0^T + a² u0 u0^T, H = [[u^T, 0], [n^T / r, -1]] on (l, psi), and
u.n0 = sin D, n.n0 = cos D. So for the standard EKF C = P H^T has in the heading's row

    s² (r0 sin D, r0 cos D / r - 1),

which is 0 only where the estimate is linearised where the landmark was made: D = 0 and r = r0. In the
right-invariant error that row is 0 wherever the estimate is. ``moments`` of second order, and exact ones,
have the same P_l,psi but for a factor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from submaps.config import ObservationConfig
from submaps.reference.compiled import Compiled, KernelFilter
from submaps.reference.ekf import Estimate
from submaps.reference.moment_filter import augment as augment_by_moments
from submaps.reference.moment_filter import update as update_by_moments
from submaps.reference.moments import Rule

Floats = NDArray[np.float64]


def range_bearing(sigma: tuple[float, float]) -> Compiled:
    """The main path's model, the sensor at the body's origin."""
    return Compiled(ObservationConfig("range_bearing", sigma))


@dataclass(frozen=True)
class Reading:
    """Range (m) and bearing (rad), with the standard deviations of both and of the vehicle's heading (rad)."""

    range: float
    bearing: float
    sigma_range: float
    sigma_bearing: float
    sigma_heading: float

    @property
    def R(self) -> Floats:
        """Covariance of the reading."""
        return np.diag(np.square([self.sigma_range, self.sigma_bearing]))


def heading_row(first: Reading, range_: float, turn: float) -> Floats:
    """The heading's row of C = P H^T (2,), the landmark now expected at ``range_`` and by ``turn`` further left."""
    r0, s2 = first.range, first.sigma_heading**2
    return s2 * np.array([r0 * math.sin(turn), r0 * math.cos(turn) / range_ - 1.0])


def innovation_covariance(first: Reading, range_: float, turn: float) -> Floats:
    """S = H P H^T + R (2, 2) of the same."""
    r0, r, s2 = first.range, range_, first.sigma_heading**2
    along, across = first.sigma_range**2, (s2 + first.sigma_bearing**2) * r0 * r0
    c, s = math.cos(turn), math.sin(turn)
    rr = across * s * s + along * c * c
    rb = (across - along) * s * c / r - s2 * r0 * s
    bb = (across * c * c + along * s * s) / (r * r) - 2.0 * s2 * r0 * c / r + s2
    return np.array([[rr, rb], [rb, bb]]) + first.R


def heading_gain(first: Reading, range_: float, turn: float) -> Floats:
    """The heading's row of W = C S^-1 (2,): what an innovation of range (rad/m) and of bearing turn the vehicle by."""
    S = innovation_covariance(first, range_, turn)
    return np.asarray(np.linalg.solve(S, heading_row(first, range_, turn)), dtype=np.float64)


def measured_gain(first: Reading, range_: float, turn: float, *, invariant: bool) -> Floats:
    """The same as numbers: what the compiled filter turns the vehicle by, per unit of each innovation."""
    model, P0 = range_bearing((first.sigma_range, first.sigma_bearing)), np.diag([0.0, 0.0, first.sigma_heading**2])
    made = KernelFilter(Estimate(np.zeros(3), P0), model, invariant=invariant, landmarks=1)
    made.augment(np.array([first.range, first.bearing]), first.R)
    bearing = first.bearing + turn
    x = np.array([0.0, 0.0, 0.0, range_ * math.cos(bearing), range_ * math.sin(bearing)])
    gains = []
    for v in 1e-3 * np.eye(2):
        kernel = KernelFilter(Estimate(x, made.estimate.P), model, invariant=invariant, landmarks=1)
        kernel.update(np.array([3]), (np.array([range_, bearing]) + v)[np.newaxis], first.R)
        gains.append(kernel.estimate.x[2] / 1e-3)
    return np.array(gains)


@dataclass(frozen=True)
class Still:
    """A vehicle that stands at the origin among landmarks (m, 2), given as (range m, bearing rad) of its own frame.

    ``sigma`` is that of a reading (m, rad). The heading estimate is 0; where it really points is a matter
    for whoever judges the estimate: no reading depends on it.
    """

    landmarks: Floats
    sigma_heading: float
    sigma: tuple[float, float]

    @property
    def R(self) -> Floats:
        """Covariance of a reading."""
        return np.diag(np.square(self.sigma))

    def _start(self) -> Estimate:
        return Estimate(np.zeros(3), np.diag([0.0, 0.0, self.sigma_heading**2]))

    def _scan(self, rng: np.random.Generator) -> Floats:
        return np.asarray(self.landmarks + rng.normal(size=self.landmarks.shape) * self.sigma)

    def watch(self, scans: int, rng: np.random.Generator, *, invariant: bool) -> tuple[Floats, Floats]:
        """Heading (rad) and its variance after each of so many scans of all landmarks, by the compiled filter."""
        count = self.landmarks.shape[0]
        kernel = KernelFilter(self._start(), range_bearing(self.sigma), invariant=invariant, landmarks=count)
        slots = np.array([kernel.augment(z, self.R) for z in self._scan(rng)])
        found = np.empty((scans, 2))
        for k in range(scans):
            kernel.update(slots, self._scan(rng), self.R)
            found[k] = kernel.rotation[0], kernel.rotation_variance[0, 0]
        return found[:, 0], found[:, 1]

    def watch_by_moments(self, scans: int, rng: np.random.Generator, rule: Rule) -> tuple[Floats, Floats]:
        """The same by a filter with the moments of a rule."""
        estimate, slots = self._start(), []
        for z in self._scan(rng):
            slots.append(estimate.x.shape[0])
            estimate = augment_by_moments(estimate, z, self.R, rule)
        found = np.empty((scans, 2))
        for k in range(scans):
            for slot, z in zip(slots, self._scan(rng), strict=True):
                estimate = update_by_moments(estimate, slot, z, self.R, rule)
            found[k] = estimate.x[2], estimate.P[2, 2]
        return found[:, 0], found[:, 1]


def surroundings(rng: np.random.Generator, count: int = 20) -> Floats:
    """Landmarks (count, 2) all round, 3 to 15 m off: (range m, bearing rad)."""
    return np.column_stack([rng.uniform(3.0, 15.0, count), rng.uniform(-math.pi, math.pi, count)])
