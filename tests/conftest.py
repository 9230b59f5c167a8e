"""What all tests share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of public data sets: ``SUBMAPS_DATA``, or ``../shared/data`` beside the project."""
    folder = Path(os.environ.get("SUBMAPS_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no data sets at {folder}; SUBMAPS_DATA names another folder")
    return folder
