"""Round trips of one connection: the shortest of late, and how much they jump about."""

from __future__ import annotations

from collections import deque

MIN_RTT_WINDOW_US = 10_000_000
"""The shortest round trip is taken over this long, as BBR does."""

JITTER_GAIN, MAX_JITTER_US = 4.0, 80_000
"""The change between neighbouring round trips, smoothed as in RFC 3550, counts this many times, up to a bound."""


class Lowest:
    """The lowest value of the last ``window_us``."""

    def __init__(self, window_us: int) -> None:
        self._window_us = window_us
        self._values: deque[tuple[int, int]] = deque()  # (time, value), rising: the front is the minimum

    @property
    def value(self) -> int:
        """0 before the first."""
        return self._values[0][1] if self._values else 0

    def note(self, now_us: int, value: int) -> None:
        """A value at ``now_us``, which never falls."""
        while self._values and self._values[-1][1] >= value:
            self._values.pop()
        self._values.append((now_us, value))
        while self._values[0][0] < now_us - self._window_us:
            self._values.popleft()


class RoundTrips:
    """What acknowledgements tell about the path besides its rate."""

    def __init__(self) -> None:
        self._lowest = Lowest(MIN_RTT_WINDOW_US)
        self._last_us: int | None = None
        self._jitter_us = 0.0

    @property
    def shortest_us(self) -> int:
        """Shortest round trip seen of late; 0 before the first."""
        return self._lowest.value

    @property
    def jitter_us(self) -> float:
        """By how much a round trip may exceed the shortest without any queue: a busy machine, a radio's scheduling.

        Only falls between neighbours are counted: jitter falls as much as it rises, a queue that builds up only rises.
        """
        return min(JITTER_GAIN * self._jitter_us, MAX_JITTER_US)

    def note(self, now_us: int, rtt_us: int) -> None:
        """A packet was acknowledged ``rtt_us`` after it was sent."""
        if self._last_us is not None:
            self._jitter_us += (2 * max(self._last_us - rtt_us, 0) - self._jitter_us) / 16
        self._last_us = rtt_us
        self._lowest.note(now_us, rtt_us)
