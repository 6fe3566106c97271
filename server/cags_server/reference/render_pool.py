"""The threads that render references: they stand back behind the loop once it serves more clients than they are."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")

NICENESS = 5
"""Above the process's own. On two cores beside 16 clients the loop otherwise finds no core for up to 200 ms, and
frames end after their display; references are no later for it (docs/network.md)."""


class RenderPool(Executor):
    """Runs reference renders. With few clients as anything else: a lone client on the same cores needs its references
    in time (36.9 dB in the demo's restored pictures, 33.4 behind the loop). Niceness cannot be taken back, hence two
    sets of threads; those that are not needed are never started.
    """

    def __init__(self, workers: int, clients: Callable[[], int]) -> None:
        """``workers`` threads at a time; ``clients()``: how many are being served."""
        self._workers, self._clients = workers, clients
        self._level = ThreadPoolExecutor(workers, thread_name_prefix="reference")
        self._behind = ThreadPoolExecutor(workers, thread_name_prefix="reference-behind", initializer=_stand_back)

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """As :meth:`concurrent.futures.Executor.submit`."""
        crowded = self._clients() > self._workers
        return (self._behind if crowded else self._level).submit(fn, *args, **kwargs)

    def shutdown(self, wait: bool = True, **options: Any) -> None:
        """As :meth:`concurrent.futures.Executor.shutdown`."""
        for pool in (self._level, self._behind):
            pool.shutdown(wait, **options)


def _stand_back() -> None:
    if sys.platform == "linux":  # elsewhere niceness is a process's, not a thread's
        os.setpriority(os.PRIO_PROCESS, 0, os.getpriority(os.PRIO_PROCESS, 0) + NICENESS)
