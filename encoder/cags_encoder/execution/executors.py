"""Where the work on frames runs: in this process, in a pool of processes, or on a dask cluster.

All three are :class:`concurrent.futures.Executor`; which one it is changes no byte of a bundle.
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
"""Frames in flight a worker and stage: one that it works on, one that waits for it."""

ATTEMPTS = 3
"""How often a cluster runs a task again whose worker went away."""

CONNECT_TIMEOUT = "5s"
"""How long a scheduler may take to answer."""

WORKER_TIMEOUT_S = 30
"""How long the first worker may take to come."""


@dataclass(frozen=True)
class Workers:
    """An executor, and how many tasks it runs at once."""

    executor: Executor
    count: int


class InlineExecutor(Executor):
    """Runs every task at once, in the caller's thread."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Run ``fn`` now."""
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


INLINE = Workers(InlineExecutor(), 1)


class Shared(Generic[T]):
    """A value that many tasks take along. Each thread of a worker keeps one copy of it, with what that has cached."""

    _held = local()

    def __init__(self, value: T) -> None:
        self._key, self._value = uuid.uuid4().hex, value

    def get(self) -> T:
        """The value."""
        return self._value

    def __getstate__(self) -> tuple[str, T]:
        return self._key, self._value

    def __setstate__(self, state: tuple[str, T]) -> None:
        self._key, value = state
        held: dict[str, Any] = self._held.__dict__.setdefault("values", {})
        if self._key not in held and len(held) >= 2 * AHEAD:
            held.clear()  # another clip's
        self._value = held.setdefault(self._key, value)


@contextmanager
def open_workers(count: int | None, scheduler: str | None = None) -> Iterator[Workers]:
    """``count`` worker processes (one a core for None, this process alone for 1), or the cluster of ``scheduler``.

    Raises :class:`ConfigError` or :class:`NetworkError` where the cluster cannot be used.
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
    """Each of ``items`` with the result of ``task(*arguments(item))``, in order.

    Items are drawn only as far ahead as keeps the workers busy, so that a chain of these holds few frames at a time.
    Raises what a task raises, and :class:`BundleError` when a worker process dies.
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
            "a worker process died, perhaps for want of memory; run again with fewer --workers: it continues"
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
            raise NetworkError(f"scheduler {scheduler}: has no workers; start some: dask worker {scheduler}") from error
        cores = sum(client.nthreads().values())
        yield Workers(client.get_executor(pure=False, retries=ATTEMPTS), cores)
