"""The client's side of a session."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from cags_common.errors import ProtocolError
from cags_common.tiles.inventory import InventoryEntry
from cags_protocol import events as ev
from cags_protocol.cadence import EVERY_FRAME
from cags_protocol.delivery.assembly import Assembler, ReceivedPackets
from cags_protocol.sessions.base import Session, SessionTimers, UnexpectedMessageError
from cags_protocol.sessions.blobs import BlobAssembler
from cags_protocol.sessions.states import CLIENT_TABLE, State
from cags_protocol.wire import limits
from cags_protocol.wire.encoding import DamagedError, decode, printable
from cags_protocol.wire.messages import (
    SERVER_DATA,
    Abandon,
    Ack,
    Blob,
    Bye,
    Control,
    Fragment,
    FrameEnd,
    Hello,
    KeyframeRequest,
    Mark,
    Message,
    Notice,
    PoseBatch,
    PoseSample,
    ReferenceFrame,
    Refusal,
    TileLayers,
    Welcome,
)

MAX_PENDING_EVICTIONS = 65536
"""Evictions that wait for an acknowledgement to carry them; beyond it the oldest are forgotten."""

MAX_DAMAGED = 16
"""Packets damaged in a row after which the connection is given up."""


@dataclass(frozen=True)
class ClientSessionSettings:
    """Times and counts of a client's session."""

    timers: SessionTimers = field(default_factory=SessionTimers)
    ack_interval_us: int = 5_000
    """Acknowledgements are at least this far apart, unless ``ack_packets`` wait for one."""
    ack_packets: int = 8
    """Packets that are acknowledged at once, whatever the time."""


class ClientSession(Session[ev.ClientEvent]):
    """One connection to a server, as the client sees it. All times are the client's clock."""

    def __init__(self, settings: ClientSessionSettings | None = None, *, now_us: int) -> None:
        self._settings = settings or ClientSessionSettings()
        super().__init__(CLIENT_TABLE, self._settings.timers, now_us=now_us)
        self._packets = ReceivedPackets()
        self._assembler = Assembler()
        self._blobs = BlobAssembler()
        self._unacked = 0
        self._received_us = self._acked_us = now_us
        self._damaged = 0
        self._evicted: dict[tuple[int, int], int] = {}
        self.damaged_packets = 0
        """Packets that failed their CRC."""
        self.buffered_bytes = 0
        """What the client holds undecoded; set by the owner, told to the server with each acknowledgement."""

    @property
    def partial_bytes(self) -> int:
        """Bytes of messages that are not complete yet."""
        return self._assembler.partial_bytes

    # --------------------------------------------------------------------------------------------------------- sending

    def hello(self, hello: Hello, *, now_us: int) -> None:
        """Say Hello; once, first."""
        if self._state is not State.GREETING:
            raise ProtocolError(f"hello is possible once, not in state {self._state.value}")
        self._state = State.DECIDING
        self._say(hello, now_us)

    def send_poses(self, samples: Iterable[PoseSample], *, now_us: int, cadence_permille: int = EVERY_FRAME) -> None:
        """Send poses, oldest first, and the share of media frames that is displayed (:mod:`cags_protocol.cadence`).

        Nothing happens unless the session is open.
        """
        poses = tuple(samples)
        if self._state is State.OPEN:
            for start in range(0, len(poses), limits.MAX_POSE_SAMPLES):
                self._say(PoseBatch(poses[start : start + limits.MAX_POSE_SAMPLES], cadence_permille), now_us)

    def control(self, control: Control, *, now_us: int) -> None:
        """Play, pause, seek or change the rate; nothing happens unless the session is open."""
        if self._state is State.OPEN:
            self._say(control, now_us)

    def request_keyframe(self, reference_seq: int, *, now_us: int) -> None:
        """Ask for an IDR picture; nothing happens unless the session is open."""
        if self._state is State.OPEN:
            self._say(KeyframeRequest(reference_seq), now_us)

    def report_evictions(self, tiles: Iterable[InventoryEntry]) -> None:
        """Tell the server, with the next acknowledgements, what the store dropped (``lods`` = what is left)."""
        for tile in tiles:
            self._evicted[tile.frame, tile.tile] = tile.lods
            if len(self._evicted) > MAX_PENDING_EVICTIONS:
                del self._evicted[next(iter(self._evicted))]  # that tile stays without these layers

    def data_to_send(self, now_us: int) -> list[bytes]:
        """Messages to write now, in order."""
        due_us = self._ack_due_us()
        if due_us is not None and now_us >= due_us:
            self._acknowledge(now_us)
        out = list(self._urgent)
        self._urgent.clear()
        return out

    def next_timer_us(self) -> int | None:
        """See :class:`Session`; also when an acknowledgement is due."""
        times = [t for t in (super().next_timer_us(), self._ack_due_us()) if t is not None]
        return min(times) if times and not self.closed else None

    def _ack_due_us(self) -> int | None:
        """When an acknowledgement is due; None while there is nothing to tell, or nobody to tell it to yet."""
        if self._state is not State.OPEN:
            return None
        if self._unacked >= self._settings.ack_packets:
            return self._received_us
        if self._unacked or self._evicted:
            return self._acked_us + self._settings.ack_interval_us
        return None

    def _acknowledge(self, now_us: int) -> None:
        some = list(self._evicted.items())[: limits.MAX_EVICTED_TILES]
        for key, _ in some:
            del self._evicted[key]
        evicted = tuple(InventoryEntry(frame, tile, lods) for (frame, tile), lods in some)
        delay_us = max(now_us - self._received_us, 0)
        self._say(Ack(self._packets.ranges, self._received_us, delay_us, self.buffered_bytes, evicted), now_us)
        self._unacked, self._acked_us = 0, now_us

    # ------------------------------------------------------------------------------------------------------- receiving

    def _on_message(self, message: Message, payload: memoryview, now_us: int) -> None:
        self._damaged = 0
        match message:
            case Fragment():
                self._on_fragment(message, payload, now_us)
            case Abandon():
                for ident in message.idents:
                    self._assembler.abandon(ident)
            case Welcome():
                self._emit(ev.Welcomed(message, now_us))
            case Notice():
                self._emit(ev.NoticeReceived(message))
            case Refusal():
                self._emit(ev.Refused(message))
                self._close("refused", f"{message.code}: {message.message}", now_us)

    def _on_fragment(self, fragment: Fragment, chunk: memoryview, now_us: int) -> None:
        if not self._packets.add(fragment.seq):
            return
        self._unacked += 1
        self._received_us = now_us
        data = self._assembler.add(fragment, chunk)
        if data is None:
            return
        try:
            message, payload = decode(data)
        except DamagedError as error:  # every packet of it was whole: the server built it so
            raise ProtocolError(f"message {fragment.ident}: {error}") from error
        if type(message) not in SERVER_DATA:
            raise ProtocolError(f"{message.TAG} must not come in fragments")
        self._on_data(message, payload)

    def _on_data(self, message: Message, payload: memoryview) -> None:
        match message:
            case TileLayers():
                self._emit(ev.TileReceived(message, payload))
            case ReferenceFrame():
                self._emit(ev.ReferenceReceived(message, payload))
            case FrameEnd():
                self._emit(ev.FrameEnded(message, payload))
            case Mark():
                self._emit(ev.MarkReceived(message))
            case Blob():
                data = self._blobs.add(message, payload)
                if data is not None:
                    self._emit(ev.BlobReceived(message.name, data))

    def _on_breach(self, error: ProtocolError, now_us: int) -> None:
        """A damaged packet is as good as lost: the gap in the acknowledgements tells the server. A breach ends all."""
        if isinstance(error, DamagedError) and self._state is State.OPEN:
            self._damaged += 1
            self.damaged_packets += 1
            if self._damaged <= MAX_DAMAGED:
                return
        if self._state is not State.GREETING:
            self._say(Bye(printable(str(error))), now_us)
        self._close("unexpected" if isinstance(error, UnexpectedMessageError) else "malformed", str(error), now_us)
