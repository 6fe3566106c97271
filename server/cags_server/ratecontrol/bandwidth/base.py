"""The bandwidth seam: acknowledgements in, bits a second out."""

from __future__ import annotations

from typing import Protocol

from cags_protocol.events import AckSample


class BandwidthEstimator(Protocol):
    """Estimates what the link to one client carries. One object a client."""

    def on_ack(self, sample: AckSample) -> None:
        """Take one acknowledgement."""
        ...

    def estimate_bps(self, now_us: int) -> float:
        """What the link carries, as far as is known: bits a second, positive and finite."""
        ...

    def allowance_bps(self, now_us: int) -> float:
        """What may be planned for from now on: more than the estimate while the link may be faster, less under load."""
        ...
