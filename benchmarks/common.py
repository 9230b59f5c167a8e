"""What the benchmarks share: where the data are, and batch optima that are computed once."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import submaps.batch
import submaps.batch_problem
import submaps.least_squares
import submaps.residuals
from service.datasets import Dataset
from submaps.batch import optimum
from submaps.measurements import Batch

ROOT = Path(__file__).resolve().parent.parent
DATA = Path(os.environ.get("SUBMAPS_DATA", ROOT.parent / "shared" / "data"))
CACHE = ROOT / ".cache" / "benchmarks"


def batch_landmarks(run: Dataset) -> dict[str, NDArray[np.float64]]:
    """Landmarks of the batch optimum by id, computed here and kept under ``.cache``.

    The file's name is a digest of the measurements, their noise and the code that solves them.
    """
    path = CACHE / f"{_digest(run)}.npz"
    if not path.exists():
        found = optimum(run.columns, run.motion, run.observation)
        CACHE.mkdir(parents=True, exist_ok=True)
        np.savez(path, ids=np.array(found.ids), landmarks=found.landmarks, chi2=found.chi2)
    with np.load(path) as kept:
        return dict(zip(kept["ids"].tolist(), kept["landmarks"], strict=True))


def verdict(name: str, value: float, limit: float, show: Callable[[float], str] = "{:.4g}".format) -> str:
    """A line that says a measured value, its limit and whether it holds."""
    return f"{name}: {show(value)} (limit {show(limit)}) {'holds' if value <= limit else 'MISSED'}"


def _digest(run: Dataset) -> str:
    columns = run.columns
    digest = hashlib.sha256()
    for module in (submaps.batch, submaps.batch_problem, submaps.residuals, submaps.least_squares):
        digest.update(Path(str(module.__file__)).read_bytes())
    digest.update(repr((run.motion, run.observation, columns.landmark)).encode())
    for array in _arrays(columns):
        digest.update(array.tobytes())
    return digest.hexdigest()[:32]


def _arrays(columns: Batch) -> list[NDArray[np.generic]]:
    given = [columns.control_covariance, columns.observation_covariance]
    always: list[NDArray[np.generic]] = [columns.t, columns.control_step, columns.control, columns.observation_step]
    return [*always, columns.z, *(array for array in given if array is not None)]
