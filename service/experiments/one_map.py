"""One right-invariant EKF over a whole planar map, in NumPy: small, and free to be taken apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps.association.candidates import Candidates, candidates
from submaps.association.readings import predicted_readings
from submaps.geometry.space import PLANE
from submaps.geometry.trig import wrap
from submaps.observation.models import MODELS, body_sensor, shown

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_MODEL = MODELS["range_bearing"]
_BODY = body_sensor(PLANE)
_J = np.array([[0.0, -1.0], [1.0, 0.0]])


class OneMap:
    """A pose and landmarks, x = (p, theta, l_1, ...), with P of the right-invariant error (``docs/conventions.md``).

    Readings are range (m) and bearing (rad) from the body's origin.
    """

    def __init__(self) -> None:
        self.x = np.zeros(3)
        self.P = np.zeros((3, 3))

    @property
    def landmarks(self) -> Floats:
        """Positions (n, 2), m."""
        return self.x[3:].reshape(-1, 2)

    def predict(self, increment: Floats, noise: Floats) -> None:
        """Through a body-frame increment (3,) with noise Q (3, 3): F = I, G = (R, -J p; 0, 1; 0, -J l_i)."""
        R = PLANE.rotation(self.x[:3])
        self.x[:3] = PLANE.compose(PLANE.as_pose(self.x), PLANE.as_pose(increment))
        G = np.zeros((self.x.shape[0], 3))
        G[:2, :2], G[2, 2] = R, 1.0
        G[:2, 2] = -_J @ self.x[:2]
        G[3:, 2] = (-self.landmarks @ _J.T).ravel()
        self.P = self.P + G @ noise @ G.T

    def candidates(self, z: Floats, noise: Floats) -> Candidates:
        """Readings (m, 2) of covariance (2, 2) against every landmark."""
        P = np.ascontiguousarray(self.P)
        readings = predicted_readings(PLANE, self.x, P, len(self.landmarks), _MODEL, _BODY, 2, True)
        return candidates(readings, z, noise[np.newaxis])

    def update(self, seen: Candidates, observations: Ints, landmarks: Ints) -> None:
        """By observations of landmarks, all at once: xi = K v, P <- P - K S K^T."""
        if not observations.size:
            return
        v, S = seen.joint(observations, landmarks)
        entries, H = seen.readings.entries, seen.readings.H
        PH = np.concatenate([self.P[:, entries[j]] @ H[j].T for j in landmarks], axis=1)
        K = np.linalg.solve(S, PH.T).T
        self._retract(K @ v)
        self.P = self.P - K @ S @ K.T
        self.P = 0.5 * (self.P + self.P.T)

    def _retract(self, xi: Floats) -> None:
        """p and l_i <- R(xi_theta) . + V(xi_theta) xi, theta <- theta + xi_theta."""
        R, V = PLANE.rotation(xi[:3]), PLANE.left_jacobian(xi[2:3])
        self.x[:2] = R @ self.x[:2] + V @ xi[:2]
        self.x[2] = wrap(self.x[2] + xi[2])
        self.x[3:] = (self.landmarks @ R.T + xi[3:].reshape(-1, 2) @ V.T).ravel()

    def augment(self, z: Floats, noise: Floats) -> None:
        """By the landmark of each reading (m, 2): xi_new = xi_p + R w, w the reading's noise in the body frame."""
        R = PLANE.rotation(self.x[:3])
        for reading in z:
            y, spread = shown(PLANE.key, _MODEL, _BODY, reading, noise)
            own = self.P[:2, :2] + R @ spread @ R.T
            self.x = np.concatenate([self.x, self.x[:2] + R @ y])
            self.P = np.block([[self.P, self.P[:, :2]], [self.P[:2], own]])

    def drop(self, landmarks: Ints) -> None:
        """Forget landmarks; what was learned of the others through them stays."""
        gone = (3 + 2 * landmarks[:, np.newaxis] + np.arange(2)).ravel()
        self.x = np.delete(self.x, gone)
        self.P = np.delete(np.delete(self.P, gone, axis=0), gone, axis=1)

    def error(self, pose: Floats, landmarks: Floats) -> Floats:
        """The xi that takes the estimate to the truth: a pose (3,), and where its landmarks (n, 2) are."""
        turn = wrap(float(pose[2] - self.x[2]))
        R, V = PLANE.rotation_of([turn]), PLANE.left_jacobian([turn])
        moved = np.vstack([pose[:2], landmarks]) - np.vstack([self.x[:2], self.landmarks]) @ R.T
        xi = np.linalg.solve(V, moved.T).T
        return np.concatenate([xi[0], [turn], xi[1:].ravel()])
