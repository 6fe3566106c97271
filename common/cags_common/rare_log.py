"""Log lines that somebody else causes: however often it happens, few lines are written about it."""

from __future__ import annotations

import logging
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any

MAX_KEYS = 1024
"""Offenders told apart; the one not heard of for longest is forgotten."""


class RareLog:
    """Writes at most one line a key (an offender, and what it did) in ``every_s``; the next line counts the others."""

    def __init__(
        self, log: logging.Logger, every_s: float = 1.0, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """``clock``: seconds."""
        self._log, self._every_s, self._clock = log, every_s, clock
        self._told: OrderedDict[Hashable, tuple[float, int]] = OrderedDict()  # key -> (when, held back since)

    def write(self, level: int, key: Hashable, message: str, *values: Any, error: BaseException | None = None) -> bool:
        """Write ``message % values``, with the traceback of ``error``, or count it; whether it was written."""
        now = self._clock()
        told_s, held_back = self._told.get(key, (float("-inf"), 0))
        self._told[key] = told_s, held_back + 1
        self._told.move_to_end(key)
        if now - told_s < self._every_s:
            return False
        self._told[key] = now, 0
        if len(self._told) > MAX_KEYS:
            self._told.popitem(last=False)
        more = f" ({held_back} more like this were not logged)" if held_back else ""
        self._log.log(level, message + more, *values, exc_info=error)
        return True
