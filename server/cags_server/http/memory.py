"""Memory that ended sessions have left goes back to the system.

The C library keeps what was freed in pieces between pieces in use, in an arena a thread: after 3,000 sessions a server
of 100 MB held 1.1 GB.
"""

from __future__ import annotations

import asyncio
import ctypes
import gc
import sys
from collections.abc import Callable

QUIET_S = 1.0
"""From the end of a session to the first attempt: others may end with it."""

LEAST_INTERVAL_S = 5.0

UNWATCHED_S = 10.0
"""Time without viewers after which what was kept for later ones is dropped; a page is loaded again in less."""

M_ARENA_MAX, ARENAS = -8, 2
"""Of ``mallopt``: threads share so many arenas."""


class FreedMemory:
    """Gives memory back once sessions have ended, seldom enough to cost nothing."""

    def __init__(self, watched: Callable[[], object], forget: Callable[[], object] = lambda: None) -> None:
        """``watched()`` says whether a long collection would delay anybody. ``forget()`` drops what was kept for
        later viewers.
        """
        self._watched, self._forget = watched, forget
        self._timer: asyncio.TimerHandle | None = None
        self._unwatched: asyncio.TimerHandle | None = None
        self._last_s = float("-inf")
        self._trim = _trimmer()

    def session_ended(self) -> None:
        """Something was freed."""
        if self._timer is None:
            loop = asyncio.get_running_loop()
            at_s = max(loop.time() + QUIET_S, self._last_s + LEAST_INTERVAL_S)
            self._timer = loop.call_at(at_s, self._give_back, loop)

    def close(self) -> None:
        """The server ends."""
        for timer in (self._timer, self._unwatched):
            if timer is not None:
                timer.cancel()

    def _give_back(self, loop: asyncio.AbstractEventLoop) -> None:
        self._timer, self._last_s = None, loop.time()
        # asyncio's transports are reference cycles; those of long sessions are in the oldest generation.
        watched = self._watched()
        gc.collect(1 if watched else 2)
        loop.run_in_executor(None, self._trim)
        if not watched:
            if self._unwatched is not None:
                self._unwatched.cancel()
            self._unwatched = loop.call_later(UNWATCHED_S, self._drop, loop)

    def _drop(self, loop: asyncio.AbstractEventLoop) -> None:
        if not self._watched():
            self._forget()
            loop.run_in_executor(None, self._trim)


def share_arenas() -> None:
    """Have all threads allocate from a few arenas; before any of them begins."""
    mallopt = _of_the_c_library("mallopt")
    if mallopt is not None:
        mallopt(M_ARENA_MAX, ARENAS)


def _trimmer() -> Callable[[], object]:
    trim = _of_the_c_library("malloc_trim")
    return (lambda: trim(0)) if trim is not None else lambda: None


def _of_the_c_library(name: str) -> Callable[..., int] | None:
    """A function of the GNU C library; None with another one, which needs no such help."""
    if sys.platform != "linux":
        return None
    try:
        function: Callable[..., int] = getattr(ctypes.CDLL(None), name)
    except (OSError, AttributeError):
        return None
    return function
