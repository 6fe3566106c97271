"""Signals that end a play as its last frame would: with a goodbye to the server, and with what was asked for kept."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from cags_common.runtime.endings import leave_at_next, on_first_request

SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def interrupts(end: Callable[[signal.Signals], object]) -> Iterator[None]:
    """Within the block the first interrupt, or request to end, calls ``end``; the next one ends the process at once."""
    remove = None
    with suppress(NotImplementedError, RuntimeError, ValueError):  # not in the main thread, or not on this system
        remove = on_first_request(end)
    try:
        yield
    finally:
        if remove is not None:
            remove()


@contextmanager
def noted_interrupts() -> Iterator[list[signal.Signals]]:
    """As :func:`interrupts`, outside of an event loop: the first signal is put into the list that the block is given.

    Whoever works in the block looks at the list, and stops where nothing is lost. The first within the block is meant:
    one that has ended a play before leaves its scoring to the next.
    """
    noted: list[signal.Signals] = []
    if threading.current_thread() is not threading.main_thread():
        yield noted
        return
    usual = {number: signal.getsignal(number) for number in SIGNALS}

    def note(number: int, _: object) -> None:
        leave_at_next()
        noted.append(signal.Signals(number))

    for number in SIGNALS:
        signal.signal(number, note)
    try:
        yield noted
    finally:
        if not noted:
            for number in SIGNALS:
                signal.signal(number, usual[number])
