"""Cases on all cores, a process each."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

LIBRARY_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")

Case = TypeVar("Case")
Result = TypeVar("Result")


def in_parallel(work: Callable[[Case], Result], cases: Sequence[Case], workers: int) -> Iterator[Result]:
    """``work`` of every case, in the cases' order; an exception of one ends the others."""
    if workers < 2 or len(cases) < 2:
        yield from map(work, cases)
        return
    with single_threaded_libraries():
        pool = ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"))
        try:
            yield from pool.map(work, cases)
        finally:
            pool.shutdown(cancel_futures=True)


@contextmanager
def single_threaded_libraries() -> Iterator[None]:
    """Workers side by side must not each start a pool of threads as large as the machine."""
    before = {name: os.environ.get(name) for name in LIBRARY_THREADS}
    os.environ.update(dict.fromkeys(LIBRARY_THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
