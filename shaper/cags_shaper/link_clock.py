"""The time of a link: it stands at 0 until the link begins."""

from __future__ import annotations

from collections.abc import Callable

STARTS = "connection", "process"
"""What begins a link: its first connection, or the shaper itself."""


class LinkClock:
    """Microseconds since :meth:`begin`; 0 before. Both directions of a link share one."""

    def __init__(self, clock: Callable[[], int]) -> None:
        """``clock`` returns microseconds, never falling."""
        self._clock = clock
        self._begun_us: int | None = None

    @property
    def begun(self) -> bool:
        """Whether time passes."""
        return self._begun_us is not None

    def begin(self) -> None:
        """Time passes from now on; only the first call counts."""
        if self._begun_us is None:
            self._begun_us = self._clock()

    def now_us(self) -> int:
        """The link's time."""
        return 0 if self._begun_us is None else self._clock() - self._begun_us
