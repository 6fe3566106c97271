"""Signals that end a play as its last frame would: with a goodbye to the server, and with what was asked for kept."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def interrupts(end: Callable[[signal.Signals], object]) -> Iterator[None]:
    """Within the block the first interrupt, or request to end, calls ``end``; later ones have their usual effect."""
    loop = asyncio.get_running_loop()

    def remove() -> None:
        for number in SIGNALS:
            loop.remove_signal_handler(number)

    def once(number: signal.Signals) -> None:
        remove()
        end(number)

    with suppress(NotImplementedError, RuntimeError, ValueError):  # not in the main thread, or not on this system
        for number in SIGNALS:
            loop.add_signal_handler(number, once, number)
    try:
        yield
    finally:
        with suppress(NotImplementedError, RuntimeError, ValueError):
            remove()
