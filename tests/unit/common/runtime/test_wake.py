"""Sleeping until something happens or a time has come."""

from __future__ import annotations

import asyncio

import pytest

from cags_common.runtime.wake import woken


@pytest.mark.parametrize("seconds", [None, 3600.0])
async def test_what_happens_wakes(seconds: float | None) -> None:
    event = asyncio.Event()
    asyncio.get_running_loop().call_soon(event.set)
    async with asyncio.timeout(5):
        await woken(event, seconds)


@pytest.mark.parametrize("seconds", [0.01, 0.0, -1.0])
async def test_the_time_wakes_and_a_time_that_has_gone_by_at_once(seconds: float) -> None:
    event = asyncio.Event()
    async with asyncio.timeout(5):
        await woken(event, seconds)
    assert event.is_set()


async def test_no_alarm_is_left_behind() -> None:
    event = asyncio.Event()
    event.set()
    await woken(event, 0.01)
    event.clear()
    waiting = asyncio.create_task(woken(event, 0.01))
    await asyncio.sleep(0)
    waiting.cancel()
    await asyncio.gather(waiting, return_exceptions=True)
    await asyncio.sleep(0.05)
    assert not event.is_set()
