"""The state of the link to one client: acknowledgements in, bits a second out. How the rate is known is the seam."""

from __future__ import annotations

from abc import ABC, abstractmethod

from cags_protocol.events import AckSample

NOTHING_YET = AckSample(now_us=0, newly_delivered_bytes=0, rtt_us=0, app_limited=True)


class LinkState(ABC):
    """What is known of one link. Budgets, pace and schedule ask it; none of them keeps what it knows."""

    def __init__(self) -> None:
        self.newest = NOTHING_YET
        """What the newest acknowledgement said of round trips, of what is in flight and of what waits at the client."""

    def on_ack(self, sample: AckSample) -> None:
        """Take one acknowledgement."""
        self.newest = sample

    @abstractmethod
    def estimate_bps(self, now_us: int) -> float:
        """What the link carries, as far as is known: bits a second, positive and finite."""

    @abstractmethod
    def allowance_bps(self, now_us: int) -> float:
        """What may be planned for from now on: more than the estimate while the link may be faster, less under load."""

    def through_us(self, size_bytes: float, now_us: int) -> float:
        """How long the link takes to carry so much, by the estimate."""
        return size_bytes * 8e6 / self.estimate_bps(now_us)
