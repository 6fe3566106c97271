"""Signals that end a play as its last frame would: with a goodbye to the server, and with what was asked for kept."""

from __future__ import annotations

import asyncio
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def interrupts(end: Callable[[signal.Signals], object]) -> Iterator[None]:
    """Within the block the first interrupt, or request to end, calls ``end``; later ones have their usual effect."""
    loop = asyncio.get_running_loop()
    usual = {number: signal.getsignal(number) for number in SIGNALS}

    def remove() -> None:
        for number in SIGNALS:
            if loop.remove_signal_handler(number):  # which leaves the system's own handler, whatever there was before
                signal.signal(number, usual[number])

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


@contextmanager
def noted_interrupts() -> Iterator[list[signal.Signals]]:
    """As :func:`interrupts`, outside of an event loop: the first signal is put into the list that the block is given.

    Whoever works in the block looks at the list, and stops where nothing is lost.
    """
    noted: list[signal.Signals] = []
    if threading.current_thread() is not threading.main_thread():
        yield noted
        return
    usual = {number: signal.getsignal(number) for number in SIGNALS}

    def remove() -> None:
        for number in SIGNALS:
            signal.signal(number, usual[number])

    def note(number: int, _: object) -> None:
        remove()
        noted.append(signal.Signals(number))

    for number in SIGNALS:
        signal.signal(number, note)
    try:
        yield noted
    finally:
        remove()
