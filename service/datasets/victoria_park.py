"""Victoria Park as the ``gtsam`` package ships it: the format of iSAM with covariances for noise.

The data: 6 969 poses of a car in a park in Sydney, 151 trees, 3 640 observations, made with laser
and wheel encoders by J. Guivant and E. Nebot; ids of the trees as prepared for iSAM.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from service.datasets.dataset import Dataset, DatasetError
from service.datasets.isam import read_isam

SOURCE = "victoria-park"


def read_victoria_park() -> Dataset:
    """Read the copy inside the installed ``gtsam``, without importing it."""
    package = find_spec("gtsam")
    if package is None or package.origin is None:
        raise DatasetError(
            f"{SOURCE}: the data come with the package gtsam, which is not installed; pip install 'submaps[demo]'"
        )
    path = Path(package.origin).parent / "Data" / "victoria_park.txt"
    if not path.is_file():
        raise DatasetError(f"{SOURCE}: the installed gtsam holds no {path.name}; pip install 'submaps[demo]'")
    return read_isam(path, noise="covariance", name=SOURCE)
