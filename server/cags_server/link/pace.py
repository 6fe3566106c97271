"""How long a frame takes from being planned to reaching the client."""

from __future__ import annotations

from cags_server.link.state import LinkState

SMOOTHING = 0.2
"""Weight of the newest frame in the means."""

SPREAD = 2.0
"""Mean deviations above the mean that the lead must cover, so that few frames come late."""

MARGIN_US = 15_000
"""Time for the client to decode and align the picture before it is due."""

MAX_CAUTION_US, CAUTION_LOST = 100_000, 0.05
"""Most that late references add to the lead, and the share of it that each reference in time removes."""


class Pace:
    """Running mean and spread of the time that references take, and by how much they were late nevertheless."""

    def __init__(self, link: LinkState) -> None:
        self._link = link
        self._mean_us = 0.0
        self._deviation_us = 0.0
        self._seen = False
        self.caution_us = 0.0
        """Added to the lead because references arrived late: the mean and the spread did not foresee a queue."""

    def observe(self, work_us: int, size_bytes: int, now_us: int) -> None:
        """A reference of ``size_bytes`` is ready, ``work_us`` after its planning."""
        took = work_us + self._link.through_us(size_bytes, now_us)
        if not self._seen:
            self._mean_us, self._deviation_us, self._seen = took, 0.0, True
            return
        self._deviation_us += SMOOTHING * (abs(took - self._mean_us) - self._deviation_us)
        self._mean_us += SMOOTHING * (took - self._mean_us)

    def arrived(self, late_us: int) -> None:
        """A reference arrived ``late_us`` after its frame was due (negative: before). Within the margin it is late."""
        late_us += MARGIN_US
        if late_us > 0:
            self.caution_us = min(self.caution_us + late_us, MAX_CAUTION_US)
        else:
            self.caution_us -= CAUTION_LOST * self.caution_us

    @property
    def needed_us(self) -> float:
        """Lead that makes the reference arrive in time, seen from the server's idea of the client's clock.

        That clock is late by the shortest way up, so the whole round trip counts.
        """
        if not self._seen:
            return 0.0
        return self._mean_us + SPREAD * self._deviation_us + self._link.newest.rtt_us + MARGIN_US
