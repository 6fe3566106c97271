"""Threads that render stand back behind the loop where it serves many; a lone client's, and the loop's own, do not."""

import os
import sys

import pytest

from cags_server.reference.render_pool import NICENESS, RenderPool


def niceness() -> int:
    """Of the calling thread."""
    return os.getpriority(os.PRIO_PROCESS, 0)


@pytest.mark.skipif(sys.platform != "linux", reason="niceness is a process's there")
def test_threads_stand_back_while_there_are_more_clients_than_they() -> None:
    before, clients = niceness(), 1
    with RenderPool(2, lambda: clients) as pool:
        alone = [pool.submit(niceness).result() for _ in range(4)]
        clients = 3
        crowded = [pool.submit(niceness).result() for _ in range(4)]
        clients = 2
        again = pool.submit(niceness).result()
    assert set(alone) == {before}
    assert set(crowded) == {min(before + NICENESS, 19)}
    assert again == before == niceness()


def test_closing_ends_both_kinds_of_threads() -> None:
    clients = 1
    pool = RenderPool(1, lambda: clients)
    pool.submit(int).result()
    clients = 5
    pool.submit(int).result()
    pool.shutdown(wait=True, cancel_futures=True)
    for count in (1, 5):
        clients = count
        with pytest.raises(RuntimeError, match="shutdown"):
            pool.submit(int)
