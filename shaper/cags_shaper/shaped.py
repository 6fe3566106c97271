"""What log and control port need of whatever is shaped: streams by the proxy, or a command's packets."""

from __future__ import annotations

from typing import Any, Protocol

from cags_shaper.link import Link
from cags_shaper.link_clock import LinkClock


class ShapedLink(Protocol):
    """One direction."""

    @property
    def link(self) -> Link[Any]:
        """What delays, queues and counts."""

    @property
    def clock(self) -> LinkClock:
        """Both directions have the same."""

    def now_us(self) -> int:
        """Time since the start of the link, microseconds."""


class Shaped(Protocol):
    """Both directions."""

    @property
    def downlink(self) -> ShapedLink:
        """Towards the client."""

    @property
    def uplink(self) -> ShapedLink:
        """Towards the server."""
