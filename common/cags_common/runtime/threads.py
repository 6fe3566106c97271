"""How many threads a piece of work is worth."""

from __future__ import annotations

ROWS_A_THREAD = 16_384
"""Rows of splats from which on another thread pays. It has to be woken and waited for, and on a busy machine it gets
no core for milliseconds: longer than the whole work takes.
"""


def threads_for_rows(rows: int, threads: int) -> int:
    """Up to ``threads``, for work of some tens of nanoseconds for each of ``rows``."""
    return max(min(threads, rows // ROWS_A_THREAD), 1)
