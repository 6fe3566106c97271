"""Runs the work on frames: in this process, in a pool of processes, or on a dask cluster.

All three are :class:`concurrent.futures.Executor`; the choice does not change the bundle's bytes.
"""

from __future__ import annotations

import os
import uuid
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import contextmanager
from dataclasses import dataclass
from threading import local
from typing import Any, Generic, TypeVar

from cags_common.errors import BundleError, ConfigError, NetworkError
from cags_common.runtime.processes import process_pool

T = TypeVar("T")
R = TypeVar("R")

AHEAD = 2
"""Frames in flight per worker and stage: one in work, one waiting."""

ATTEMPTS = 3
"""How often a cluster repeats a task whose worker was lost."""

CONNECT_TIMEOUT = "5s"
"""Time limit for a scheduler's answer."""

WORKER_TIMEOUT_S = 30
"""Time limit for the first worker to appear."""


@dataclass(frozen=True)
class Workers:
    """An executor, and the number of tasks that it runs in parallel."""

    executor: Executor
    count: int


class InlineExecutor(Executor):
    """Runs every task immediately in the caller's thread."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Run ``fn`` immediately."""
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


INLINE = Workers(InlineExecutor(), 1)


class Shared(Generic[T]):
    """A value shared by many tasks. Each thread of a worker keeps one copy, including what the value has cached."""

    _held = local()

    def __init__(self, value: T) -> None:
        self._key, self._value = uuid.uuid4().hex, value

    def get(self) -> T:
        """Return the value."""
        return self._value

    def __getstate__(self) -> tuple[str, T]:
        return self._key, self._value

    def __setstate__(self, state: tuple[str, T]) -> None:
        self._key, value = state
        held: dict[str, Any] = self._held.__dict__.setdefault("values", {})
        if self._key not in held and len(held) >= 2 * AHEAD:
            held.clear()  # values of another clip
        self._value = held.setdefault(self._key, value)


@contextmanager
def open_workers(count: int | None, scheduler: str | None = None) -> Iterator[Workers]:
    """``count`` worker processes (None: one per core; 1: only this process), or the cluster of ``scheduler``.

    Raises :class:`ConfigError` or :class:`NetworkError` if the cluster cannot be used.
    """
    if scheduler is not None:
        with _cluster(scheduler) as workers:
            yield workers
        return
    count = count or len(os.sched_getaffinity(0))
    if count == 1:
        yield INLINE
        return
    with process_pool(count, "forkserver") as pool:
        yield Workers(pool, count)


def ahead(
    workers: Workers, task: Callable[..., R], items: Iterable[T], arguments: Callable[[T], tuple[Any, ...]]
) -> Iterator[tuple[T, R]]:
    """Yield each of ``items`` with the result of ``task(*arguments(item))``, in order.

    Items are requested only as far ahead as keeps the workers busy, so a chain of these holds few frames at a time.
    Raises a task's exceptions, and :class:`BundleError` if a worker process dies.
    """
    waiting: deque[tuple[T, Future[R]]] = deque()
    window = 1 if workers is INLINE else AHEAD * workers.count
    try:
        for item in items:
            waiting.append((item, workers.executor.submit(task, *arguments(item))))
            if len(waiting) >= window:
                yield _first(waiting)
        while waiting:
            yield _first(waiting)
    except BrokenExecutor as error:
        raise BundleError(
            "a worker process died, perhaps out of memory; run again with fewer --workers to continue"
        ) from error
    finally:
        for _, future in waiting:
            future.cancel()


def _first(waiting: deque[tuple[T, Future[R]]]) -> tuple[T, R]:
    item, future = waiting.popleft()
    return item, future.result()


@contextmanager
def _cluster(scheduler: str) -> Iterator[Workers]:
    try:
        from distributed import Client
    except ImportError as error:
        raise ConfigError(
            f"scheduler = {scheduler!r} needs dask.distributed; pip install 'cags-stream[scale]'"
        ) from error
    try:
        client = Client(scheduler, timeout=CONNECT_TIMEOUT)
    except (OSError, ValueError, TimeoutError) as error:
        raise NetworkError(
            f"scheduler {scheduler}: cannot be reached ({error or 'no answer'}); is it running?"
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=WORKER_TIMEOUT_S)
        except TimeoutError as error:
            raise NetworkError(
                f"scheduler {scheduler}: has no workers; start one with: dask worker {scheduler}"
            ) from error
        cores = sum(client.nthreads().values())
        yield Workers(client.get_executor(pure=False, retries=ATTEMPTS), cores)
