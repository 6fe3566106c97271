"""Runs cases on all cores, each in its own process."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from cags_common.runtime.processes import process_pool

Case = TypeVar("Case")
Result = TypeVar("Result")


def in_parallel(work: Callable[[Case], Result], cases: Sequence[Case], workers: int) -> Iterator[Result]:
    """Apply ``work`` to every case, in order; an exception in one ends the others."""
    if workers < 2 or len(cases) < 2:
        yield from map(work, cases)
        return
    with process_pool(workers) as pool:
        yield from pool.map(work, cases)
