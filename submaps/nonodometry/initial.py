"""A first belief: points that are given with noise, or made from the first views alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from submaps.errors import MeasurementError
from submaps.nonodometry.belief import Belief
from submaps.nonodometry.bundle import Bundle, adjust
from submaps.nonodometry.likelihood import maximum_likelihood
from submaps.nonodometry.poses import Poses, stack
from submaps.nonodometry.sensor import Camera
from submaps.vision.depth import reconstruct
from submaps.vision.epipolar import essential_matrix, fundamental_matrix, relative_pose

Floats = NDArray[np.float64]


def noisy(points: Floats, sigma: float, rng: np.random.Generator) -> Belief:
    """The points (n, 3), each coordinate with an error of ``sigma`` m, and the covariance that says so."""
    return Belief(points + sigma * rng.normal(size=points.shape), sigma**2 * np.eye(points.size))


def from_views(camera: Camera, z: Floats, first: Poses, baseline: float) -> Bundle:
    """Points and poses of maximum likelihood from views z (n, k, 2), from nothing but them and the gauge.

    ``first`` is the pose of the first view and ``baseline`` (m) the distance from its camera to the
    last one's. The essential matrix of first and last view gives a start, each view between them the
    pose that the points so far make most likely, and bundle adjustment the rest; it may not be found.
    """
    rays = (z - camera.centre) / camera.focal
    try:
        fundamental = fundamental_matrix(rays[0], rays[-1])
    except MeasurementError:
        return _nothing(z, first)
    two = relative_pose(essential_matrix(fundamental, np.eye(3), np.eye(3)), rays[0], rays[-1]).scaled(baseline)
    points = reconstruct(two.rotation, two.translation, rays[0], rays[-1]) @ first.rotation.T + first.position
    last = Poses(first.rotation @ two.rotation.T, first.position + first.rotation @ two.translation)
    if two.before_both < len(points):
        return _nothing(z, first)
    chain = [first]
    for view in z[1:-1]:
        fit = maximum_likelihood(camera, points[np.newaxis], view, chain[-1].repeat(1))
        chain.append(fit.poses.take(0))
    return adjust(camera, z, points, stack([*chain, last]))


def _nothing(z: Floats, first: Poses) -> Bundle:
    k = z.shape[1]
    unknown = Belief(np.full((k, 3), np.nan), np.full((3 * k, 3 * k), np.nan))
    return Bundle(unknown, first.repeat(len(z)), float("inf"), found=False)
