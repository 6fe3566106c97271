"""Pools of worker processes, for work that keeps every core busy for long."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from threading import Thread
from typing import Literal

LIBRARY_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")


@contextmanager
def process_pool(workers: int, start: Literal["spawn", "forkserver"] = "spawn") -> Iterator[ProcessPoolExecutor]:
    """A pool of ``workers`` processes, one library thread each, none of which outlives this process.

    Leaving by an exception cancels what waits and does not wait for what runs.
    """
    with _single_threaded_libraries():
        pool = ProcessPoolExecutor(workers, multiprocessing.get_context(start), initializer=_end_with_parent)
        done = False
        try:
            yield pool
            done = True
        finally:
            pool.shutdown(wait=done, cancel_futures=True)


def _end_with_parent() -> None:
    """End this worker when the process that asked for it is gone, killed too: an idle worker would wait for ever."""
    parent = multiprocessing.parent_process()
    assert parent is not None, "a worker has a parent"

    def watch() -> None:
        parent.join()
        os._exit(1)

    Thread(target=watch, name="ends with parent", daemon=True).start()


@contextmanager
def _single_threaded_libraries() -> Iterator[None]:
    """Workers inherit these: with one process a core, each library's threads are in the others' way."""
    before = {name: os.environ.get(name) for name in LIBRARY_THREADS}
    os.environ.update(dict.fromkeys(LIBRARY_THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
