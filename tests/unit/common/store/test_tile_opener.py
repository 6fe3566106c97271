"""Opening tiles on several threads."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import pytest

from cags_common.store.tile_decode import TileOpener


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_work_in_the_pool_may_use_the_pool(threads: int) -> None:
    """What is shown again is decoded in the pool and opens its tiles there: both threads waited for each other."""
    opener = TileOpener(None, threads)

    def outer(number: int) -> list[int]:
        return opener.run(lambda each: each + number, [1, 2, 3])

    with ThreadPoolExecutor(1) as watched:
        found = watched.submit(opener.run, outer, range(4)).result(timeout=20)
    assert found == [[1 + n, 2 + n, 3 + n] for n in range(4)]
