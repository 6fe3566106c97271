"""Sessions end without cycles, and what they leave goes back to the system."""

from __future__ import annotations

import asyncio
import gc
import time
import weakref

import pytest

from cags_protocol import events as ev
from cags_server.http import memory
from support.live_server import Client, serving


async def visit(server) -> None:
    client = await Client.join(server)
    await client.until(ev.FrameEnded)
    await client.leave()


async def test_ended_sessions_leave_no_cycles(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "QUIET_S", 1e6)
    async with serving() as (app, server):
        await visit(server)
        gc.collect()
        gc.disable()
        try:
            for _ in range(5):
                await visit(server)
            async with asyncio.timeout(5):
                while app._clients:  # noqa: ASYNC110
                    await asyncio.sleep(0.01)
            await asyncio.sleep(0.1)
            gc.set_debug(gc.DEBUG_SAVEALL)
            gc.collect()
            ours = [type(each) for each in gc.garbage if type(each).__module__.startswith("cags_")]
        finally:
            gc.set_debug(0)
            gc.garbage.clear()
            gc.enable()
    assert ours == []


async def test_memory_is_given_back_once_for_many_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "QUIET_S", 0.02)
    monkeypatch.setattr(memory, "LEAST_INTERVAL_S", 0.2)
    trims = 0

    def trim() -> None:
        nonlocal trims
        trims += 1

    monkeypatch.setattr(memory, "_trimmer", lambda: trim)
    freed = memory.FreedMemory(lambda: True)
    begun = time.monotonic()
    for _ in range(30):
        freed.session_ended()
        await asyncio.sleep(0.01)
    await asyncio.sleep(0.3)
    freed.close()
    assert 1 <= trims <= 1 + (time.monotonic() - begun) / 0.2, "once in an interval"


@pytest.mark.parametrize("returns", [True, False])
async def test_what_was_kept_for_further_viewers_is_dropped_once_nobody_has_watched_for_a_while(
    monkeypatch: pytest.MonkeyPatch, returns: bool
) -> None:
    monkeypatch.setattr(memory, "QUIET_S", 0.01)
    monkeypatch.setattr(memory, "UNWATCHED_S", 0.1)
    watching, dropped = [False], []
    freed = memory.FreedMemory(lambda: watching[0], lambda: dropped.append(True))
    try:
        freed.session_ended()
        await asyncio.sleep(0.05)
        watching[0] = returns
        await asyncio.sleep(0.15)
        assert dropped == ([] if returns else [True])
    finally:
        freed.close()


class Cycle:
    """What only a collection ends."""

    def __init__(self) -> None:
        self.me = self


@pytest.mark.parametrize("watched", [True, False])
async def test_what_has_lasted_is_collected_once_nobody_waits_for_it(
    monkeypatch: pytest.MonkeyPatch, watched: bool
) -> None:
    monkeypatch.setattr(memory, "QUIET_S", 0.01)
    freed = memory.FreedMemory(lambda: watched)
    lasting = Cycle()
    gone = weakref.ref(lasting)
    gc.collect()  # it is in the oldest generation now
    del lasting
    gc.disable()
    try:
        freed.session_ended()
        await asyncio.sleep(0.1)
        assert (gone() is not None) == watched
    finally:
        gc.enable()
        freed.close()
