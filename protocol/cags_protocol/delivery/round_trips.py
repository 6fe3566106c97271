"""Delays of one connection: what a round trip takes now, the shortest of late, and how much both jump about."""

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


class _Jitter:
    """The change between neighbouring round trips, smoothed."""

    def __init__(self) -> None:
        self._last_us: int | None = None
        self._mean_us = 0.0

    @property
    def us(self) -> float:
        """By how much a round trip may exceed the shortest without any queue: a busy machine, a radio's scheduling."""
        return min(JITTER_GAIN * self._mean_us, MAX_JITTER_US)

    def note(self, rtt_us: int) -> None:
        """Only falls are counted: jitter falls as much as it rises, a queue that builds up only rises."""
        if self._last_us is not None:
            self._mean_us += (2 * max(self._last_us - rtt_us, 0) - self._mean_us) / 16
        self._last_us = rtt_us


class RoundTrips:
    """Round trips of packets, as they are *read*, and *without* the time until the server reads an acknowledgement.

    The client's clock tells when a packet arrived. The excess of its one-way delay over the shortest one of late is
    what it waited on the link, whatever both clocks say; that and the shortest round trip are its own. A client's clock
    that was set counts for nothing: a round trip is no longer than the time until now.
    """

    def __init__(self) -> None:
        self._shortest = Lowest(MIN_RTT_WINDOW_US)
        self._one_way = Lowest(MIN_RTT_WINDOW_US)  # from the server's clock to the client's: of any sign
        self._jitter, self._jitter_as_read = _Jitter(), _Jitter()
        self.newest_us = 0
        """Of the newest packet, without the server's own delay; 0 before the first."""

    @property
    def shortest_us(self) -> int:
        """Shortest of late: the path without a queue; 0 before the first."""
        return self._shortest.value

    @property
    def jitter_us(self) -> float:
        """By how much a round trip may exceed the shortest without any queue."""
        return self._jitter.us

    @property
    def jitter_as_read_us(self) -> float:
        """The same with the time until the server reads an acknowledgement: a busy server looks again that late."""
        return self._jitter_as_read.us

    def note(self, now_us: int, until_now_us: int, one_way_us: int) -> None:
        """A packet was acknowledged ``until_now_us`` after it was sent.

        ``one_way_us`` is its arrival by the client's clock less its sending by the server's.
        """
        self._shortest.note(now_us, until_now_us)
        self._one_way.note(now_us, one_way_us)
        self.newest_us = min(until_now_us, self.shortest_us + one_way_us - self._one_way.value)
        self._jitter.note(self.newest_us)
        self._jitter_as_read.note(until_now_us)
