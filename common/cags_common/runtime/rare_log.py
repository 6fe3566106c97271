"""Log lines that somebody else causes: however often it happens, few lines are written about it."""

from __future__ import annotations

import logging
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any

MAX_KEYS = 1024
"""Offenders told apart; the one not heard of for longest is forgotten."""


@dataclass
class _Told:
    room: float  # lines that may be written now
    at_s: float
    held_back: int = 0


class _Allowance:
    """One line a key in ``every_s``, and ``burst`` of them at once."""

    def __init__(self, every_s: float, burst: int, clock: Callable[[], float]) -> None:
        self._every_s, self._burst, self._clock = every_s, burst, clock
        self._told: OrderedDict[Hashable, _Told] = OrderedDict()

    def take(self, key: Hashable) -> int | None:
        """How many were held back since the last line, if one may be written now; else None."""
        now = self._clock()
        told = self._told.get(key)
        if told is None:
            told = self._told[key] = _Told(self._burst, now)
            if len(self._told) > MAX_KEYS:
                self._told.popitem(last=False)
        self._told.move_to_end(key)
        told.room = min(told.room + (now - told.at_s) / self._every_s, self._burst)
        told.at_s = now
        if told.room < 1:
            told.held_back += 1
            return None
        told.room -= 1
        held_back, told.held_back = told.held_back, 0
        return held_back


class RareLog:
    """Writes a line a key (an offender, and what it did) in ``every_s`` at most; the next line counts the others."""

    def __init__(
        self,
        log: logging.Logger,
        every_s: float = 1.0,
        *,
        burst: int = 1,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """``burst`` lines a key may come at once. ``clock``: seconds."""
        self._log, self._allowance = log, _Allowance(every_s, burst, clock)

    def write(self, level: int, key: Hashable, message: str, *values: Any, error: BaseException | None = None) -> bool:
        """Write ``message % values``, with the traceback of ``error``, or count it; whether it was written."""
        held_back = self._allowance.take(key)
        if held_back is None:
            return False
        self._log.log(level, message + _more(held_back), *values, exc_info=error)
        return True


class RareFilter(logging.Filter):
    """Holds back what other packages say again and again: a line a second and place in the code, and a few at once."""

    def __init__(self, ours: str = "cags", *, clock: Callable[[], float] = time.monotonic) -> None:
        """Loggers whose names begin with ``ours`` look after themselves."""
        super().__init__()
        self._ours, self._allowance = ours, _Allowance(1.0, 5, clock)

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether the record is to be written."""
        if record.name.startswith(self._ours):
            return True
        held_back = self._allowance.take((record.name, record.pathname, record.lineno))
        if held_back:
            record.msg = str(record.msg) + _more(held_back)
        return held_back is not None


def _more(held_back: int) -> str:
    return f" ({held_back} more like this were not logged)" if held_back else ""
