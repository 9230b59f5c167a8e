"""Readers of recorded runs: one file a format, each giving the same columns that HTTP takes."""

from __future__ import annotations

from pathlib import Path

from service.datasets.dataset import Dataset, DatasetError, Truth
from service.datasets.g2o import is_g2o, read_g2o
from service.datasets.isam import read_isam
from service.datasets.mrclam import is_mrclam, read_mrclam
from service.datasets.starry_night import CALIBRATION, is_starry_night, read_starry_night
from service.datasets.victoria_park import SOURCE as VICTORIA_PARK
from service.datasets.victoria_park import read_victoria_park

__all__ = ["SOURCES", "VICTORIA_PARK", "Dataset", "DatasetError", "Truth", "read_source"]

SOURCES = f"an iSAM or g2o text file, an MRCLAM or Starry Night folder, or {VICTORIA_PARK}"


def read_source(source: str, *, odometry: bool = True) -> Dataset:
    """Read a data set by its name (``victoria-park``) or its path: a file of iSAM's or g2o's, a folder.

    Without ``odometry`` it is left out, and the map's motion model is ``none``. Raises ``DatasetError``,
    also where a data set cannot do without.
    """
    path = Path(source)
    if source != VICTORIA_PARK and is_starry_night(path):
        return read_starry_night(path, odometry=odometry)
    if not odometry:
        raise DatasetError(f"{source}: only a data set whose readings show points in space can do without odometry")
    if source == VICTORIA_PARK:
        return read_victoria_park()
    if not path.exists():
        raise DatasetError(f"{source}: no such file; give {SOURCES}")
    if path.is_dir():
        if not is_mrclam(path):
            raise DatasetError(f"{source}: a folder without Barcodes.dat or {CALIBRATION}; give {SOURCES}")
        return read_mrclam(path)
    return read_g2o(path) if is_g2o(path) else read_isam(path)
