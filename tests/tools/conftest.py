"""What the tools' tests share: a small run as a file, and a service for each of their files."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from service.standalone import own_service
from tests.tools.support import write_rounds


@pytest.fixture(scope="module")
def run_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_rounds(tmp_path_factory.mktemp("runs") / "Two Rounds.txt")


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    with own_service() as address:
        yield address
