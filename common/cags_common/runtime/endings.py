"""Requests to end a process: the first one ends it in order, the next one at once.

A first interrupt (Ctrl-C, SIGINT), SIGTERM or closed terminal (SIGHUP) lets a command say goodbye, and remove what it
has begun. Whoever asks again does not want to wait for that.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

EXIT_SIGNAL = 128
"""Plus the number of the signal that ended a command, as shells count."""

REQUESTS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

HEARD_TWICE_S = 0.3
"""A terminal and the program that started a command may both pass a request on: within so long it is one, seconds."""

SHOW_CURSOR = b"\x1b[?25h"
"""A live table hides the cursor, and would show it again in its own time."""


_heard = False


def heard() -> bool:
    """Whether this process has been asked to end (:func:`leave_at_next`)."""
    return _heard


def leave_at_next(heard_s: float | None = None) -> None:
    """From now on, a request to end ends this process at once, with no word and the code 128 + its number.

    ``heard_s``: when the first request was heard, by the monotonic clock; now, if not given (or long ago, where none
    was and everything is in order). Ignored signals stay so.
    Outside of the main thread this does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        return
    global _heard  # noqa: PLW0603 - of the process, as its signals are
    _heard = _heard or heard_s is None
    since_s = time.monotonic() if heard_s is None else heard_s

    def leave(number: int, _: object) -> None:
        if time.monotonic() - since_s >= HEARD_TWICE_S:
            _leave(number)

    for number in REQUESTS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, leave)


def on_first_request(end: Callable[[signal.Signals], object]) -> Callable[[], None]:
    """Call ``end`` in the running loop at the first SIGINT or SIGTERM; the next one ends the process at once.

    Returns what undoes it, and gives the handlers back that were there before, as long as no signal has come. Raises
    :class:`NotImplementedError`, :class:`RuntimeError` or :class:`ValueError` where a loop can have no handlers.
    """
    import asyncio  # it takes long to load, and not every command has a loop

    loop = asyncio.get_running_loop()
    numbers = (signal.SIGINT, signal.SIGTERM)
    usual = {number: signal.getsignal(number) for number in numbers}

    def remove() -> None:
        for number in numbers:
            if loop.remove_signal_handler(number):  # which leaves the system's own handler, whatever there was before
                signal.signal(number, usual[number])

    def once(number: signal.Signals) -> None:
        remove()
        leave_at_next()
        end(number)

    for number in numbers:
        loop.add_signal_handler(number, once, number)
    return remove


def _leave(number: int) -> None:
    """End this process and ask its children to end."""
    with suppress(OSError):
        if os.isatty(2):
            os.write(2, SHOW_CURSOR)
    with suppress(OSError):  # Linux only; elsewhere children hear of it by the pipes they share with this process
        for task in Path("/proc/self/task").iterdir():
            for child in (task / "children").read_text().split():
                with suppress(OSError):
                    os.kill(int(child), signal.SIGTERM)
    os._exit(EXIT_SIGNAL + number)
