"""Pools of worker processes, for work that keeps every core busy for long."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from threading import Thread
from typing import Any, Literal

LEFT_TO_PARENT = (signal.SIGINT, signal.SIGTERM)

PARENTS_TURN_S = 2.0
"""Time for a parent to end, and its workers with it, after a signal to all of them, seconds."""

LIBRARY_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")


@contextmanager
def process_pool(workers: int, start: Literal["spawn", "forkserver"] = "spawn") -> Iterator[ProcessPoolExecutor]:
    """A pool of ``workers`` processes, one library thread each, none of which outlives this process.

    Signals of a terminal or a supervisor reach all of them; the workers leave it to this process to say what follows.
    Leaving by an exception cancels what waits and does not wait for what runs.
    """
    with _environment(_of_workers()):
        pool = _Pool(workers, multiprocessing.get_context(start), initializer=_end_with_parent)
        done = False
        try:
            yield pool
            done = True
        finally:
            pool.shutdown(wait=done, cancel_futures=True)


class _Pool(ProcessPoolExecutor):
    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """See :meth:`concurrent.futures.Executor.submit`, which starts the workers: they inherit what is blocked."""
        before = signal.pthread_sigmask(signal.SIG_BLOCK, LEFT_TO_PARENT)
        try:
            return super().submit(fn, *args, **kwargs)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end_with_parent() -> None:
    """End this worker when the process that asked for it is gone, killed too: an idle worker would wait for ever.

    One that is asked to end gives its parent time to say so itself: a pool that loses a worker fails in many words.
    """
    signal.pthread_sigmask(signal.SIG_BLOCK, LEFT_TO_PARENT)
    parent = multiprocessing.parent_process()
    assert parent is not None, "a worker has a parent"

    def watch() -> None:
        parent.join()
        os._exit(1)

    def heed() -> None:
        signal.sigwait({signal.SIGTERM})
        time.sleep(PARENTS_TURN_S)
        os._exit(1)

    Thread(target=watch, name="ends with parent", daemon=True).start()
    Thread(target=heed, name="ends when asked", daemon=True).start()


def _of_workers() -> dict[str, str]:
    """Variables that workers inherit: with one process a core, each library's threads are in the others' way.

    Python's tracker of semaphores would tell of those that are left when a parent ends at once, and removes them.
    """
    warnings = filter(None, (os.environ.get("PYTHONWARNINGS"), "ignore:resource_tracker:UserWarning"))
    return {**dict.fromkeys(LIBRARY_THREADS, "1"), "PYTHONWARNINGS": ",".join(warnings)}


@contextmanager
def _environment(variables: Mapping[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
