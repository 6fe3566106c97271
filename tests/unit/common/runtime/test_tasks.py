"""A background task's fault is told at once."""

from __future__ import annotations

import asyncio

from cags_common.runtime.tasks import watched


async def test_a_fault_is_told_and_an_ordinary_end_or_a_cancellation_is_not() -> None:
    faults: list[BaseException] = []

    async def fail() -> None:
        raise ValueError("broken")

    async def sleep() -> None:
        await asyncio.sleep(60)

    async def end() -> None:
        pass

    tasks = [watched(work, faults.append) for work in (fail(), sleep(), end())]
    await asyncio.sleep(0.01)
    tasks[1].cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    assert [str(fault) for fault in faults] == ["broken"]
