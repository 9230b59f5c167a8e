"""A recorded run of one robot, whatever file it came from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from submaps.config import MotionConfig, ObservationConfig
from submaps.measurements import Batch


class DatasetError(Exception):
    """A data set cannot be read; the message names the file, the line and what was expected."""


@dataclass(frozen=True)
class Dataset:
    """One robot's run: its models with their noise, and every measurement as one batch of columns."""

    name: str
    motion: MotionConfig
    observation: ObservationConfig
    columns: Batch

    def batches(self, max_observations: int = 1000, max_steps: int = 5000) -> Iterator[Batch]:
        """Cut the run into consecutive batches, none above either bound.

        A step is never split, so a single step with more observations makes a batch of its own.
        """
        observed = self.columns.observation_step
        start = 0
        while start < self.columns.steps:
            first = int(np.searchsorted(observed, start))
            stop = min(start + max_steps, self.columns.steps)
            if first + max_observations < observed.shape[0]:
                stop = min(stop, int(observed[first + max_observations]))
            stop = max(stop, start + 1)
            yield cut(self.columns, start, stop)
            start = stop


def cut(batch: Batch, start: int, stop: int) -> Batch:
    """Steps ``start`` to ``stop`` (exclusive) of a batch, with their step numbers from zero."""
    controls = _span(batch.control_step, start, stop)
    seen = _span(batch.observation_step, start, stop)
    control_covariance = batch.control_covariance
    observation_covariance = batch.observation_covariance
    return Batch(
        t=batch.t[start:stop].copy(),
        control_step=batch.control_step[controls] - start,
        control=np.ascontiguousarray(batch.control[:, controls]),
        control_covariance=None if control_covariance is None else control_covariance[controls].copy(),
        observation_step=batch.observation_step[seen] - start,
        landmark=batch.landmark[seen],
        z=np.ascontiguousarray(batch.z[:, seen]),
        observation_covariance=None if observation_covariance is None else observation_covariance[seen].copy(),
    )


def _span(steps: np.ndarray, start: int, stop: int) -> slice:
    first, last = np.searchsorted(steps, [start, stop])
    return slice(int(first), int(last))
