"""The one door to Numba: strict arithmetic, compiled at import, cached by a digest of the sources.

Numba notices an edited function only in the file that it compiles, not in the files it calls. The
cache folder is therefore named by a digest of every source that holds compiled functions: an edit
in any of them starts a fresh one. The folder lies below ``SUBMAPS_CACHE_DIR``, else the user's cache folder, else
the system's temporary folder, whichever is writable first.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import numba

F = TypeVar("F", bound=Callable[..., Any])

_PACKAGE = Path(__file__).parent


def _source_digest() -> str:
    digest = hashlib.blake2b(f"{numba.__version__}".encode(), digest_size=12)
    for path in sorted(_PACKAGE.rglob("*.py")):
        source = path.read_bytes()
        if b"import jit" in source:
            digest.update(path.relative_to(_PACKAGE).as_posix().encode() + source)
    return digest.hexdigest()


def _writable_home() -> Path | None:
    user_cache = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    homes = [os.environ.get("SUBMAPS_CACHE_DIR"), user_cache, tempfile.gettempdir()]
    for home in filter(None, homes):
        folder = Path(home) / "submaps" / _source_digest()
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                return folder
        except OSError:
            continue
    return None


CACHE_DIR = _writable_home()


@contextmanager
def _cache_dir() -> Iterator[None]:
    """Point Numba at our folder while one function is decorated, and leave other users alone."""
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(CACHE_DIR)
    try:
        yield
    finally:
        numba.config.CACHE_DIR = before


def jit(*signatures: str, unlocked: bool = False, inline: bool = False) -> Callable[[F], F]:
    """Compile a function without ``fastmath``; an ``unlocked`` one runs without the interpreter lock.

    Only what takes long is: a short function that gives the lock away may wait milliseconds to have
    it back. An ``inline`` one becomes part of what calls it: arrays are dear to pass. With a signature it is
    compiled (or read from the cache) at import, so that no request ever waits for a compiler.
    """

    def decorate(function: F) -> F:
        options = {"nogil": unlocked, "cache": CACHE_DIR is not None, "error_model": "numpy", "forceinline": inline}
        with _cache_dir():
            return numba.njit(list(signatures) or None, **options)(function)  # type: ignore[no-any-return]

    return decorate
