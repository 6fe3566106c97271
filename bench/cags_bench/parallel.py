"""Cases on all cores, a process each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from cags_common.runtime.processes import process_pool

Case = TypeVar("Case")
Result = TypeVar("Result")


def in_parallel(work: Callable[[Case], Result], cases: Sequence[Case], workers: int) -> Iterator[Result]:
    """``work`` of every case, in the cases' order; an exception of one ends the others."""
    if workers < 2 or len(cases) < 2:
        yield from map(work, cases)
        return
    with process_pool(workers) as pool:
        yield from pool.map(work, cases)
