"""The link's own trace as the estimate: the paper's setting, where the bandwidth limit is known."""

from __future__ import annotations

from typing import Protocol

from cags_server.link.state import LinkState

MIN_BPS = 1e3


class RateTrace(Protocol):
    """Anything that knows the mean rate of the link between two times of the server's clock."""

    def mean_bps(self, start_us: int, end_us: int) -> float:
        """Mean rate in bits a second."""
        ...


class OracleLink(LinkState):
    """Mean rate of ``trace`` over the next ``ahead_us``; ``origin_us`` is the server's clock where the trace starts."""

    def __init__(self, trace: RateTrace, *, origin_us: int = 0, ahead_us: int = 33_333, share: float = 1.0) -> None:
        super().__init__()
        self._trace, self._origin_us, self._ahead_us, self._share = trace, origin_us, ahead_us, share

    def estimate_bps(self, now_us: int) -> float:
        """See :class:`~cags_server.link.state.LinkState`."""
        start = max(0, now_us - self._origin_us)
        return max(MIN_BPS, self._share * self._trace.mean_bps(start, start + self._ahead_us))

    def allowance_bps(self, now_us: int) -> float:
        """What is known needs no probing."""
        return self.estimate_bps(now_us)
