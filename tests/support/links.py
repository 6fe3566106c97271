"""Links in tests: one whose figures a test sets, and one that is told of round trips as a session tells."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from cags_protocol.delivery.round_trips import RoundTrips
from cags_protocol.events import AckSample
from cags_server.link import LinkState, MeasuredLink


class KnownLink(LinkState):
    """Carries ``rate_bps``."""

    def __init__(self, rate_bps: float = 8e6) -> None:
        super().__init__()
        self.rate_bps = rate_bps

    def estimate_bps(self, now_us: int) -> float:
        return self.rate_bps

    def allowance_bps(self, now_us: int) -> float:
        return self.rate_bps

    def told(self, **figures: Any) -> None:
        """An acknowledgement comes that says so; the rest is as before."""
        self.on_ack(replace(self.newest, **figures))


class ToldLink(MeasuredLink):
    """A measured link whose acknowledgements are read at once: their time is the packet's round trip."""

    def __init__(self, *initial_bps: float) -> None:
        super().__init__(*initial_bps)
        self._trips = RoundTrips()

    def ack(self, now_us: int, size: int, rtt_us: int, app_limited: bool, rate: float | None, **more: Any) -> None:
        trips = self._trips
        trips.note(now_us, rtt_us, rtt_us)
        more |= {"shortest_rtt_us": trips.shortest_us, "jitter_us": trips.jitter_us}
        self.on_ack(AckSample(now_us, size, trips.newest_us, app_limited, rate, **more))
