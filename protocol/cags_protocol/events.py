"""What sessions tell the code that owns them. Plain values; no session state is reachable through them."""

from __future__ import annotations

import enum
from collections.abc import Hashable
from dataclasses import dataclass
from typing import TypeAlias

from cags_common.tiles.inventory import InventoryEntry
from cags_protocol.cadence import EVERY_FRAME
from cags_protocol.wire.messages import (
    Control,
    FrameEnd,
    Hello,
    Mark,
    Message,
    Notice,
    PoseSample,
    ReferenceFrame,
    Refusal,
    TileLayers,
    Welcome,
)


@dataclass(frozen=True, eq=False)
class Outgoing:
    """A message that the server wants to send, by value.

    ``priority`` 0 goes first; within one priority messages go in the order they were queued. At ``deadline_us`` (server
    clock) what is not sent yet is stale and dropped. A newer message of the same ``key`` replaces one that waits. An
    ``urgent`` message goes before references.
    """

    message: Message
    payload: bytes | memoryview = b""
    priority: int = 0
    deadline_us: int | None = None
    key: Hashable = None
    urgent: bool = False


class Stance(enum.Enum):
    """How a connection responds to a queue on the link."""

    GIVE_WAY = enum.auto()
    COMPETE = enum.auto()
    TRY = enum.auto()
    """Sends less for a moment, to see whether the queue is its own."""


@dataclass(frozen=True)
class AckSample:
    """What one acknowledgement says of the link. Times of the server's clock.

    ``delivery_rate_bps`` is the rate sample of draft-cheng-iccrg-delivery-rate-estimation (None: no new packet);
    ``app_limited`` says that the server had nothing to send during it, so the link may be faster than that.
    """

    now_us: int
    newly_delivered_bytes: int
    rtt_us: int
    """Round trip of the newest packet, without the time that its acknowledgement waited at either end."""
    app_limited: bool
    delivery_rate_bps: float | None = None
    in_flight_bytes: int = 0
    queued_bytes: int = 0
    undecoded_bytes: int = 0
    """What the client holds and has not decoded yet."""
    shortest_rtt_us: int = 0
    """Shortest of the last ten seconds: the path's delay without queueing."""
    jitter_us: float = 0.0
    """By how much a round trip may exceed the shortest without any queue."""
    stance: Stance = Stance.GIVE_WAY
    """How the connection responds to a queue."""

    @property
    def queue_us(self) -> int:
        """What the newest packet waited in front of the link; with it, whatever round trips jump about by."""
        return self.rtt_us - self.shortest_rtt_us


# ------------------------------------------------------------------------------------------------- server's events


@dataclass(frozen=True)
class Joined:
    """A client said Hello in a version that is spoken here: answer by ``accept`` or ``refuse``."""

    hello: Hello


@dataclass(frozen=True)
class PosesReceived:
    """Poses, oldest first, when they arrived (server clock), and the share of media frames that the client displays."""

    samples: tuple[PoseSample, ...]
    now_us: int
    cadence_permille: int = EVERY_FRAME


@dataclass(frozen=True)
class Acknowledged:
    """An acknowledgement of new packets."""

    sample: AckSample


@dataclass(frozen=True)
class Evicted:
    """The client's store dropped these down to the ``lods`` named."""

    tiles: tuple[InventoryEntry, ...]


@dataclass(frozen=True)
class ControlReceived:
    """Play, pause, seek or a change of rate; ``now_us`` is the server's clock at arrival."""

    control: Control
    now_us: int


@dataclass(frozen=True)
class KeyframeRequested:
    """The client's reference video is broken after ``reference_seq``."""

    reference_seq: int


@dataclass(frozen=True)
class Sent:
    """The last fragment was handed to the transport."""

    outgoing: Outgoing
    now_us: int


@dataclass(frozen=True)
class Delivered:
    """The client acknowledged every fragment."""

    outgoing: Outgoing
    now_us: int


@dataclass(frozen=True)
class Dropped:
    """The client will not get this: ``reason`` is stale, replaced, overflow, cancelled, lost or closed.

    ``sent_bytes`` of it went over the wire for nothing.
    """

    outgoing: Outgoing
    reason: str
    sent_bytes: int
    now_us: int


# ------------------------------------------------------------------------------------------------- client's events


@dataclass(frozen=True)
class Welcomed:
    """The server opened the session."""

    welcome: Welcome
    now_us: int


@dataclass(frozen=True)
class BlobReceived:
    """A blob is complete."""

    name: str
    data: bytes


@dataclass(frozen=True)
class TileReceived:
    """Layers of a tile. The CRC of each LoD has been covered by that of the message."""

    message: TileLayers
    payload: memoryview


@dataclass(frozen=True)
class ReferenceReceived:
    """A reference: one H.264 access unit, or nothing."""

    message: ReferenceFrame
    payload: memoryview


@dataclass(frozen=True)
class FrameEnded:
    """The server plans nothing more for a frame for now; ``payload`` holds the removed ids."""

    message: FrameEnd
    payload: memoryview


@dataclass(frozen=True)
class MarkReceived:
    """What came before this is the basis of references that name it."""

    message: Mark


@dataclass(frozen=True)
class NoticeReceived:
    """A word for the viewer or the log."""

    notice: Notice


@dataclass(frozen=True)
class Refused:
    """The server ended the session, and why."""

    refusal: Refusal


# --------------------------------------------------------------------------------------------------- both's events


@dataclass(frozen=True)
class Closed:
    """The session is over. ``code`` is bye, refused, timeout, malformed, unexpected or lost; ``reason`` one line."""

    code: str
    reason: str


ServerEvent: TypeAlias = (
    Joined | PosesReceived | Acknowledged | Evicted | ControlReceived | KeyframeRequested | Sent | Delivered | Dropped
    | Closed
)  # fmt: skip
ClientEvent: TypeAlias = (
    Welcomed
    | BlobReceived
    | TileReceived
    | ReferenceReceived
    | FrameEnded
    | MarkReceived
    | NoticeReceived
    | Refused
    | Closed
)
