"""How many threads work is worth."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from cags_common.runtime.threads import ROWS_A_THREAD, threads_for_rows


@given(st.integers(0, 10**7), st.integers(1, 256))
def test_small_work_keeps_to_one_thread_and_large_work_takes_what_it_may(rows: int, threads: int) -> None:
    taken = threads_for_rows(rows, threads)
    assert 1 <= taken <= threads
    assert (taken - 1) * ROWS_A_THREAD <= rows
    assert threads_for_rows(ROWS_A_THREAD * threads, threads) == threads
