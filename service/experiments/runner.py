"""The workers that an experiment's runs are shared out to: one process a core, one thread each.

Results come back in the order of the items and every item is computed in a worker with one BLAS
thread, so neither the number of workers nor of cores shows in them.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.process import BaseProcess
from types import TracebackType
from typing import TypeVar

import numpy as np

from service.commands.console import bar

A = TypeVar("A")
B = TypeVar("B")

# What a worker reads as it starts. Each of the first limits the threads of one build of BLAS; the last two
# make glibc keep freed memory: arrays of a megabyte, made and dropped, otherwise cost their page faults
# again and again (measured: up to twice the time of a small batch).
_STARTS_WITH = {
    **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"),
    **dict.fromkeys(("MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_"), str(64 << 20)),
}


class WorkerLost(RuntimeError):
    """A worker process ended before its work was done, as when memory runs out."""


def cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):  # not on macOS, nor on Windows
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class Workers:
    """``Runs`` on a pool of processes, which start with the first work and end with the ``with`` block.

    They are spawned, not forked: what a parent's threads hold is no concern of theirs. Ctrl-C reaches
    the parent alone, which then ends its workers, whatever they are at.
    """

    def __init__(self, count: int, seed: int, *, workers: int | None = None, quiet: bool = False) -> None:
        self.count = count
        self.seed = seed
        self._workers = workers or cores()
        self._progress = bar(quiet)
        self._pool: ProcessPoolExecutor | None = None
        self._strangers: set[BaseProcess] = set()  # children that are not of the pool

    def __enter__(self) -> Workers:
        self._strangers = set(multiprocessing.active_children())
        self._pool = ProcessPoolExecutor(self._workers, mp_context=multiprocessing.get_context("spawn"))
        self._progress.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self._progress.stop()
        pool, self._pool = self._pool, None
        if pool is None:
            return
        if error is not None:  # nobody waits for what the workers are at
            pool.shutdown(wait=False, cancel_futures=True)
            for child in set(multiprocessing.active_children()) - self._strangers:
                child.terminate()
        pool.shutdown(wait=True)

    def generators(self, count: int) -> list[np.random.SeedSequence]:
        """The first ``count`` children of the seed; a second call gives the same ones again.

        So what is compared on equal noise asks twice, and what needs more chance inside a run spawns
        from the seed of that run.
        """
        return np.random.SeedSequence(self.seed).spawn(count)

    def each(self, function: Callable[[A], B], items: Sequence[A], doing: str) -> list[B]:
        """``function`` of every item, in order; raises what it raises, or ``WorkerLost``."""
        if self._pool is None:
            raise RuntimeError("the workers are used inside their with block only")
        task = self._progress.add_task(doing, total=len(items))
        with _environment():
            waiting: list[Future[B]] = [self._pool.submit(function, item) for item in items]
        try:
            for done in as_completed(waiting):
                done.result()  # the first fault ends the rest
                self._progress.advance(task)
        except BrokenProcessPool as error:
            raise WorkerLost(f"a worker process ended while {doing}; was there memory enough?") from error
        return [one.result() for one in waiting]


@contextmanager
def _environment() -> Iterator[None]:
    """What workers inherit when they start: one BLAS thread, and no ear for Ctrl-C."""
    before = {name: os.environ.get(name) for name in _STARTS_WITH}
    os.environ.update(_STARTS_WITH)
    blocks = hasattr(signal, "pthread_sigmask")  # not on Windows
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if blocks else set()
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
        if blocks:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
