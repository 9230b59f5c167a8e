"""The container image, checked without a container engine."""

from __future__ import annotations

import os
import re
import shutil
import stat
import subprocess
import sys
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import httpx
import pytest
from dockerfile_parse import DockerfileParser

from service.standalone import LISTENING

ROOT = Path(__file__).resolve().parent.parent.parent
PINNED = re.compile(r"^([a-z0-9][a-z0-9._-]*)==(\S+)", re.MULTILINE)
HASH = re.compile(r"--hash=sha256:[0-9a-f]{64}")


@pytest.fixture(scope="module")
def dockerfile() -> list[dict[str, Any]]:
    parser = DockerfileParser(fileobj=(ROOT / "docker" / "Dockerfile").open("rb"))
    try:
        return [line for line in parser.structure if line["instruction"] != "COMMENT"]
    finally:
        parser.fileobj.close()


def values(dockerfile: list[dict[str, Any]], instruction: str) -> list[str]:
    return [line["value"] for line in dockerfile if line["instruction"] == instruction]


def sent_to_the_engine(path: str) -> bool:
    """Whether ``.dockerignore`` lets a path through; the last pattern that matches decides."""
    let_through = True
    for line in (ROOT / ".dockerignore").read_text().splitlines():
        pattern = line.removeprefix("!")
        if pattern and not pattern.startswith("#"):
            parts = [str(p) for p in [Path(path), *Path(path).parents]]
            names = [pattern.removeprefix("**/"), pattern]
            if any(fnmatch(part, name) or fnmatch(Path(part).name, names[0]) for part in parts for name in names):
                let_through = line.startswith("!")
    return let_through


def test_what_is_copied_exists_and_is_not_ignored(dockerfile: list[dict[str, Any]]) -> None:
    sources = [
        word
        for value in values(dockerfile, "COPY")
        if "--from=" not in value
        for word in value.split()[:-1]
        if not word.startswith("--")
    ]
    assert sources
    for source in sources:
        assert (ROOT / source).exists(), source
        assert sent_to_the_engine(source), source
    assert sent_to_the_engine("submaps/mapper.py")
    for private in ("requirements.lock", ".git/config", "tests/conftest.py", "service/__pycache__/cli.pyc"):
        assert not sent_to_the_engine(private), private


def test_it_runs_as_nobody_in_particular(dockerfile: list[dict[str, Any]]) -> None:
    user = values(dockerfile, "USER")[-1]
    assert user.isdigit(), "orchestrators check runAsNonRoot by number"
    assert user != "0"


def test_its_base_is_named_and_it_says_whether_it_is_well(dockerfile: list[dict[str, Any]]) -> None:
    for base in values(dockerfile, "FROM"):
        assert re.match(r"^python:\$\{PYTHON\}-slim\b", base)
    assert re.match(r"^PYTHON=\d+\.\d+$", values(dockerfile, "ARG")[0])
    assert "/readyz" in values(dockerfile, "HEALTHCHECK")[0]
    for instruction in ("ENTRYPOINT", "CMD"):
        assert values(dockerfile, instruction)[0].startswith("["), "the exec form passes signals on"


def test_the_command_of_the_health_check_is_python() -> None:
    text = (ROOT / "docker" / "Dockerfile").read_text()
    code = re.search(r'"-c", "((?:[^"\\]|\\.)*)"', text)
    assert code is not None
    compile(code[1].replace('\\"', '"'), "healthcheck", "exec")


def test_every_package_is_pinned_with_hashes_and_nothing_says_where_it_comes_from() -> None:
    locks = {name: (ROOT / name).read_text() for name in ("requirements.lock", "docker/requirements.lock")}
    for name, text in locks.items():
        assert "://" not in text, name
        for line in text.splitlines():
            assert not line.startswith("-"), f"{name}: {line}"
        blocks = re.split(r"\n(?=[a-z0-9])", text)[1:]
        assert blocks
        assert all(PINNED.match(block) and HASH.search(block) for block in blocks), name
    everything = dict(PINNED.findall(locks["requirements.lock"]))
    service = dict(PINNED.findall(locks["docker/requirements.lock"]))
    assert service.items() <= everything.items(), "make lock makes the two agree again"
    assert not {"gtsam", "pytest", "mypy", "matplotlib"} & service.keys()


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clean folder with what the image's last stage copies into ``/opt/submaps``."""
    home = tmp_path_factory.mktemp("image")
    ignored = shutil.ignore_patterns("__pycache__", "*.pyc")
    for package in ("submaps", "service"):
        shutil.copytree(ROOT / package, home / "app" / package, ignore=ignored)
    shutil.copy(ROOT / "docker" / "start", home / "start")
    return home


def environment(image: Path, **given: str) -> dict[str, str]:
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    # Without compiling: that is what the image's build is for, and takes a while.
    return {"PATH": path, "PYTHONPATH": str(image / "app"), "HOME": str(image), "NUMBA_DISABLE_JIT": "1", **given}


def test_what_is_copied_is_enough_to_serve(image: Path, tmp_path: Path) -> None:
    assert (ROOT / "docker" / "start").stat().st_mode & stat.S_IXUSR
    cache = tmp_path / "cache"
    cache.mkdir()
    given = environment(image, SUBMAPS_CACHE_DIR=str(cache), SUBMAPS_PORT="0", SUBMAPS_DATA_DIR=str(tmp_path / "data"))
    with subprocess.Popen([image / "start", "serve"], cwd=tmp_path, env=given, stdout=subprocess.PIPE) as child:
        try:
            assert child.stdout is not None
            line = child.stdout.readline().decode()
            assert line.startswith(LISTENING)
            assert httpx.get(line.removeprefix(LISTENING).split()[0] + "/healthz").status_code == 200
        finally:
            child.terminate()
            child.wait(30)


def test_a_cache_that_cannot_be_written_is_copied_to_the_temporary_folder(image: Path, tmp_path: Path) -> None:
    (tmp_path / "start").write_text((image / "start").read_text().replace("[ ! -w", "[ -w"))  # root may write all
    (tmp_path / "start").chmod(0o755)
    cache, temporary = tmp_path / "cache", tmp_path / "tmp"
    cache.mkdir()
    temporary.mkdir()
    (cache / "kernel").write_text("compiled")
    given = environment(image, SUBMAPS_CACHE_DIR=str(cache), TMPDIR=str(temporary))
    subprocess.run([tmp_path / "start", "--help"], cwd=tmp_path, env=given, capture_output=True, timeout=60, check=True)
    assert (temporary / "submaps-cache" / "kernel").read_text() == "compiled"
