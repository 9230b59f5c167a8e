"""Readers of recorded runs: one file a format, each giving the same columns that HTTP takes."""

from __future__ import annotations

from pathlib import Path

from service.datasets.dataset import Dataset, DatasetError
from service.datasets.isam import read_isam
from service.datasets.victoria_park import SOURCE as VICTORIA_PARK
from service.datasets.victoria_park import read_victoria_park

__all__ = ["VICTORIA_PARK", "Dataset", "DatasetError", "read_source"]


def read_source(source: str) -> Dataset:
    """Read a data set by its name (``victoria-park``) or its path (an iSAM text file)."""
    if source == VICTORIA_PARK:
        return read_victoria_park()
    path = Path(source)
    if not path.exists():
        raise DatasetError(f"{source}: no such file; give the path of an iSAM text file, or {VICTORIA_PARK}")
    return read_isam(path)
