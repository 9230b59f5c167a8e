"""From correspondences to the motion between two cameras: fundamental and essential matrix.

Hartley & Zisserman, "Multiple View Geometry", 2nd edition, chapters 9 and 11, in the lecture's frames:
X' = R (X − t), hence E = R S(t), y'ᵀ E y = 0, where S(t) is the cross-product matrix.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from submaps.errors import MeasurementError
from submaps.vision.depth import depth, homogeneous

Floats = NDArray[np.float64]

_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # W of eq. 9.13


@dataclass(frozen=True)
class RelativePose:
    """Camera two in camera one's frame, X' = R (X − t), and how many points both have before them.

    ``translation`` (3,) has length 1 until ``scaled``: two images do not tell how far apart they were taken.
    """

    rotation: Floats
    translation: Floats
    before_both: int

    def scaled(self, baseline: float) -> RelativePose:
        """The same with the distance (m) between the cameras known, as between two fixed to one rig."""
        length = float(np.linalg.norm(self.translation))
        return RelativePose(self.rotation, self.translation * (baseline / length), self.before_both)


def fundamental_matrix(x: Floats, x_two: Floats) -> Floats:
    """F (3, 3) of rank 2 and norm 1 with x'ᵀ F x = 0, by the normalised eight-point algorithm (11.1, 11.2).

    ``x`` and ``x_two`` (n, 2) are image points of the same n ≥ 8 points of the scene, in pixels or
    normalised. Points on one plane, or cameras at one place, leave F open. Raises ``MeasurementError``
    where they cannot say what F is.
    """
    if x.shape != x_two.shape or x.ndim != 2 or x.shape[1] != 2 or len(x) < 8:
        raise MeasurementError(f"got {x.shape} and {x_two.shape}, expected two arrays (n, 2), n at least 8")
    if not (np.all(np.isfinite(x)) and np.all(np.isfinite(x_two))):
        raise MeasurementError("got an image point that is not finite")
    to, to_two = _normalisation(x), _normalisation(x_two)
    a, b = homogeneous(x) @ to.T, homogeneous(x_two) @ to_two.T
    rows = (b[:, :, np.newaxis] * a[:, np.newaxis, :]).reshape(-1, 9)
    _, values, vectors = np.linalg.svd(rows, full_matrices=True)
    if values[7] < 1e-12 * values[0]:
        raise MeasurementError("the correspondences leave the fundamental matrix open: one plane, or no motion")
    left, sizes, right = np.linalg.svd(vectors[8].reshape(3, 3))
    of_rank_two = (left * (sizes * (1.0, 1.0, 0.0))) @ right
    found = to_two.T @ of_rank_two @ to
    return np.asarray(found / np.linalg.norm(found))


def essential_matrix(fundamental: Floats, calibration: Floats, calibration_two: Floats) -> Floats:
    """E = K'ᵀ F K, moved to the nearest matrix with singular values (1, 1, 0) (9.12; 11.7.3)."""
    left, _, right = np.linalg.svd(calibration_two.T @ fundamental @ calibration)
    return np.asarray((left * (1.0, 1.0, 0.0)) @ right)


def motions(essential: Floats) -> list[tuple[Floats, Floats]]:
    """The four (R, t), t of length 1, that E can mean (9.6.2): two rotations, and t or −t.

    In these frames t is the right null vector of E, where with X' = R X + t it is the left one.
    """
    left, _, right = np.linalg.svd(essential)
    turns = [left @ turn @ right for turn in (_TURN, _TURN.T)]
    turns = [turn * np.sign(np.linalg.det(turn)) for turn in turns]
    return [(turn, sign * right[2]) for turn in turns for sign in (1.0, -1.0)]


def relative_pose(essential: Floats, y: Floats, y_two: Floats) -> RelativePose:
    """Of the four motions the one that has most points before both cameras (9.6.3); y (n, 2) are normalised."""
    best: RelativePose | None = None
    for rotation, translation in motions(essential):
        x3 = depth(rotation, translation, y, y_two)
        x3_two = (homogeneous(y) * x3[:, np.newaxis] - translation) @ rotation[2]
        count = int(np.sum((x3 > 0.0) & (x3_two > 0.0)))
        if best is None or count > best.before_both:
            best = RelativePose(rotation, translation, count)
    assert best is not None
    return best


def normalised(x: Floats, calibration: Floats) -> Floats:
    """Image points y (n, 2) of pixels (n, 2): (y, 1) = K⁻¹ (x, 1), as everything calibrated takes them."""
    rays = np.linalg.solve(calibration, homogeneous(x).T).T
    return np.asarray(rays[:, :2] / rays[:, 2:])


def _normalisation(x: Floats) -> Floats:
    """The similarity that puts the centre of the points at 0 and their mean distance at √2 (11.2)."""
    centre = x.mean(axis=0)
    spread = float(np.mean(np.linalg.norm(x - centre, axis=1)))
    scale = np.sqrt(2.0) / spread if spread > 0.0 else 1.0
    return np.array([[scale, 0.0, -scale * centre[0]], [0.0, scale, -scale * centre[1]], [0.0, 0.0, 1.0]])
