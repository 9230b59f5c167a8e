"""The estimator is pure: it imports no service, reads no clock, draws no chance, and writes no log."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator

import pytest

from tests.conftest import ROOT

PACKAGE = ROOT / "submaps"
ALLOWED = {
    "__future__", "collections", "dataclasses", "enum", "functools", "hashlib", "heapq", "itertools", "math", "re",
    "threading", "typing", "networkx", "numpy", "qdldl", "scipy", "submaps",
}  # fmt: skip
# The door to Numba finds a folder for compiled code; nothing else touches a file.
EXTRA = {"_jit.py": {"contextlib", "numba", "os", "pathlib", "tempfile"}}
SOURCES = sorted(p.relative_to(PACKAGE).as_posix() for p in PACKAGE.rglob("*.py"))


def imported(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield "submaps" if node.level else (node.module or "").split(".")[0]


@pytest.mark.parametrize("name", SOURCES)
def test_what_a_file_imports(name: str) -> None:
    tree = ast.parse((PACKAGE / name).read_text())
    assert set(imported(tree)) <= ALLOWED | EXTRA.get(name, set())


@pytest.mark.parametrize("name", SOURCES)
def test_no_file_prints_opens_or_draws(name: str) -> None:
    tree = ast.parse((PACKAGE / name).read_text())
    calls = {n.func.id for n in ast.walk(tree) if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)}
    assert not calls & {"print", "open", "input", "eval", "exec"}
    drawn = {n.attr for n in ast.walk(tree) if isinstance(n, ast.Attribute)}
    assert "default_rng" not in drawn
    assert "random" not in {
        n.attr for n in ast.walk(tree)
        if isinstance(n, ast.Attribute) and n.attr == "random" and not _is_generator_type(tree, n)
    }  # fmt: skip


def _is_generator_type(tree: ast.AST, node: ast.Attribute) -> bool:
    """Whether ``np.random`` here only names the type of a generator that was handed in."""
    outer = [n for n in ast.walk(tree) if isinstance(n, ast.Attribute) and n.value is node]
    return all(n.attr == "Generator" for n in outer)


def test_it_works_where_the_service_is_absent() -> None:
    script = (
        "import sys, importlib.abc\n"
        "class Refuse(importlib.abc.MetaPathFinder):\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name.split('.')[0] in {'service', 'fastapi', 'pydantic', 'sqlite3', 'logging.handlers'}:\n"
        "            raise ImportError(name)\n"
        "sys.meta_path.insert(0, Refuse())\n"
        "import numpy as np\n"
        "from submaps.mapper import Mapper\n"
        "from submaps.atlas.joining import join\n"
        "from submaps.config import MapConfig, MotionConfig, ObservationConfig\n"
        "from submaps.simulation import circle, drive\n"
        "world = circle(laps=0.5)\n"
        "sensor = ObservationConfig('cartesian', (0.25, 0.25))\n"
        "mapper = Mapper(MapConfig(MotionConfig('velocity', world.velocity_sigma), sensor))\n"
        "mapper.apply('a', drive(world, np.random.default_rng(0)).batch)\n"
        "mapper.install(join(mapper.problem()))\n"
        "print(mapper.view().pose('a').kind)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "joined"


def test_random_numbers_come_from_the_generator_that_is_handed_in() -> None:
    import numpy as np

    from submaps.simulation import circle, drive

    world = circle(laps=0.2)
    a, b, c = (drive(world, np.random.default_rng(seed)).batch for seed in (1, 1, 2))
    assert np.array_equal(a.z, b.z)
    assert np.array_equal(a.control, b.control)
    assert not np.array_equal(a.control, c.control)
