"""Sleeping until something happens or a time has come, hundreds of times a second.

``asyncio.wait_for`` makes a task for each wait, and it and ``asyncio.timeout`` raise and catch a cancellation where the
time comes first.
"""

from __future__ import annotations

import asyncio


async def woken(event: asyncio.Event, seconds: float | None) -> None:
    """Until ``event`` is set, or ``seconds`` have gone by (None: however long it takes); the event is set then too."""
    if seconds is None:
        await event.wait()
        return
    timer = asyncio.get_running_loop().call_later(seconds, event.set)
    try:
        await event.wait()
    finally:
        timer.cancel()
