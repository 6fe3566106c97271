"""The client's side of fragments: which packets arrived, and messages put together from them. All of it bounded."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field

from cags_common.errors import ProtocolError
from cags_protocol.wire import limits
from cags_protocol.wire.messages import Fragment, SeqRange


class ReceivedPackets:
    """Numbers of the packets that arrived, as ranges; the newest :data:`limits.MAX_ACK_RANGES` are kept."""

    def __init__(self) -> None:
        self._ranges: list[SeqRange] = []  # newest first

    @property
    def ranges(self) -> tuple[SeqRange, ...]:
        """Newest first."""
        return tuple(self._ranges)

    def add(self, seq: int) -> bool:
        """Note packet ``seq``; False if it came before or is too old to tell."""
        full = len(self._ranges) >= limits.MAX_ACK_RANGES
        if full and seq < self._ranges[-1].first - 1:
            return False
        for index, known in enumerate(self._ranges):
            if known.first <= seq <= known.last:
                return False
            if seq > known.last:
                self._insert(index, seq)
                return True
        self._insert(len(self._ranges), seq)
        return True

    def _insert(self, index: int, seq: int) -> None:
        """Put ``seq`` before range ``index``, merging with the neighbours that it touches."""
        first = last = seq
        if index < len(self._ranges) and self._ranges[index].last == seq - 1:
            first = self._ranges.pop(index).first
        if index > 0 and self._ranges[index - 1].first == seq + 1:
            index -= 1
            last = self._ranges.pop(index).last
        self._ranges.insert(index, SeqRange(first, last))
        del self._ranges[limits.MAX_ACK_RANGES :]


@dataclass(slots=True)
class Partial:
    """Chunks of one message or blob of ``total`` bytes, in any order of arrival."""

    total: int
    received: int = 0
    """Bytes of all chunks."""
    _chunks: dict[int, bytes] = field(default_factory=dict)

    def holds(self, offset: int) -> bool:
        """Whether the chunk that begins at ``offset`` has come."""
        return offset in self._chunks

    def add(self, offset: int, chunk: memoryview) -> None:
        """Keep a copy of ``chunk``."""
        self._chunks[offset] = bytes(chunk)
        self.received += len(chunk)

    def joined(self, what: str) -> bytes:
        """All of it. Raises :class:`ProtocolError` naming ``what`` for chunks that overlap or do not add up."""
        position = 0
        ordered = sorted(self._chunks.items())
        for offset, chunk in ordered:
            if offset != position:
                raise ProtocolError(f"{what}: its parts overlap or leave a gap at byte {min(offset, position)}")
            position += len(chunk)
        if position != self.total:
            raise ProtocolError(f"{what}: its parts have {position} bytes, its total is {self.total}")
        return b"".join(chunk for _, chunk in ordered)


class Assembler:
    """Puts messages together from fragments in any order."""

    def __init__(self) -> None:
        self._partials: OrderedDict[int, Partial] = OrderedDict()
        self._closed: OrderedDict[int, None] = OrderedDict()
        self.partial_bytes = 0
        """Bytes held of messages that are not complete."""

    def __len__(self) -> int:
        return len(self._partials)

    def add(self, fragment: Fragment, chunk: memoryview) -> bytes | memoryview | None:
        """Take a fragment; the whole encoded message once it is complete. Raises :class:`ProtocolError`."""
        if fragment.ident in self._closed:
            return None
        if not fragment.total:
            self._close(fragment.ident)
            return chunk
        partial = self._partials.setdefault(fragment.ident, Partial(fragment.total))
        if partial.total != fragment.total or partial.holds(fragment.offset):
            raise ProtocolError(f"fragment of message {fragment.ident} contradicts an earlier one")
        partial.add(fragment.offset, chunk)
        self.partial_bytes += len(chunk)
        if partial.received >= partial.total:
            self._close(fragment.ident)
            return partial.joined(f"message {fragment.ident}")
        self._bound()
        return None

    def abandon(self, ident: int) -> None:
        """Forget a message; later fragments of it are ignored."""
        self._close(ident)

    def _close(self, ident: int) -> None:
        partial = self._partials.pop(ident, None)
        if partial is not None:
            self.partial_bytes -= partial.received
        self._closed[ident] = None
        if len(self._closed) > 4 * limits.MAX_PARTIAL_MESSAGES:
            self._closed.popitem(last=False)

    def _bound(self) -> None:
        while len(self._partials) > limits.MAX_PARTIAL_MESSAGES or self.partial_bytes > limits.MAX_PARTIAL_BYTES:
            self._close(next(iter(self._partials)))
