"""The server's queue: bounded, ordered by value, cut into fragments, stale data dropped.

Order: marks, urgent messages, reference pictures, then everything else by priority; first come first served in each.
The most valuable fragment goes next, so a reference picture never waits behind tiles, not even behind the rest of a
tile half sent; and from the moment that a mark is queued nothing is sent to its end before it.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, field

from cags_protocol.events import Outgoing
from cags_protocol.wire import limits
from cags_protocol.wire.encoding import encode, encode_parts
from cags_protocol.wire.messages import Blob, Fragment, Mark, ReferenceFrame

FRAGMENT_HEADER_BYTES = 48
"""Room left in a packet for the header of a :class:`Fragment`; its fields at their widest take 41 bytes."""

CHUNK_BYTES = limits.PACKET_BYTES - FRAGMENT_HEADER_BYTES
"""Largest number of bytes of a message in one packet."""

SLACK_ENTRIES = 64
"""Entries that have left and may stay in the heaps of a queue, besides as many as there are messages in it."""

Rank = tuple[int, int, int]
"""Class, priority and number of a message."""

MARKS, URGENT, REFERENCES, OTHERS = range(4)
"""Classes of messages, the more urgent first."""


@dataclass(eq=False)
class Entry:
    """One queued message and how much of it is sent."""

    ident: int
    outgoing: Outgoing
    rank: Rank
    head: bytes
    body: memoryview
    sent: int = 0
    unacked: set[int] = field(default_factory=set)
    settled: bool = False  # its one Delivered or Dropped event is out

    @property
    def size(self) -> int:
        """Bytes of the encoded message."""
        return len(self.head) + len(self.body)

    @property
    def started(self) -> bool:
        """Whether a fragment has been sent."""
        return self.sent > 0

    @property
    def finished(self) -> bool:
        """Whether all fragments have been sent."""
        return self.sent == self.size

    @property
    def hurries(self) -> bool:
        """Whether this may use the reserve of credit: a reference picture, or what goes before them."""
        return self.rank[0] < OTHERS

    def chunk(self, most_bytes: int) -> bytes | memoryview:
        """The next fragment, of at most ``most_bytes``."""
        start = self.sent - len(self.head)
        if start >= 0:
            return self.body[start : start + most_bytes]
        head = self.head[self.sent : self.sent + most_bytes]
        return head + self.body[: most_bytes - len(head)]


OnDrop = Callable[[Entry, str], None]


class SendQueue:
    """Messages that wait, at most ``max_bytes`` and ``max_messages`` of them; ``on_drop`` hears of each one dropped."""

    def __init__(self, max_bytes: int, max_messages: int, on_drop: OnDrop) -> None:
        self._max_bytes, self._max_messages = max_bytes, max_messages
        self.on_drop = on_drop
        self._entries: dict[int, Entry] = {}
        self._by_key: dict[Hashable, Entry] = {}
        self._heap: list[tuple[Rank, int]] = []
        self._deadlines: list[tuple[int, int]] = []
        self._next_ident = 1
        self._started = 0
        self.queued_bytes = 0
        """Bytes of messages not sent yet."""

    def __len__(self) -> int:
        return len(self._entries)

    def __iter__(self) -> Iterator[Entry]:
        return iter(self._entries.values())

    def put(self, outgoing: Outgoing) -> None:
        """Queue a message. Beyond the bounds the least valuable one that is not started is dropped, maybe this one.
        Parts of blobs, without which a client could do nothing for the whole session, are dropped last.

        Raises :class:`ProtocolError` for a message that must not travel.
        """
        ident, self._next_ident = self._next_ident, self._next_ident + 1
        rank = (_class_of(outgoing), outgoing.priority, ident)
        head, body = encode_parts(outgoing.message, outgoing.payload)
        entry = Entry(ident, outgoing, rank, head, memoryview(body))
        self._replace(entry)
        self._entries[ident] = entry
        self.queued_bytes += entry.size
        heapq.heappush(self._heap, (entry.rank, ident))
        if outgoing.deadline_us is not None:
            heapq.heappush(self._deadlines, (outgoing.deadline_us, ident))
        while self.queued_bytes > self._max_bytes or len(self._entries) > self._max_messages:
            self.drop(max(self._entries.values(), key=_dispensable), "overflow")

    def cancel(self, match: Callable[[Outgoing], bool], *, started: bool = True) -> None:
        """Drop every message that ``match`` names; without ``started`` only those of which nothing was sent."""
        for entry in [e for e in self._entries.values() if (started or not e.started) and match(e.outgoing)]:
            self.drop(entry, "cancelled")

    def drop(self, entry: Entry, reason: str) -> None:
        """Take ``entry`` out and report it."""
        self._forget(entry)
        self.on_drop(entry, reason)

    def expire(self, now_us: int) -> None:
        """Drop what is stale at ``now_us``."""
        while self._deadlines and self._deadlines[0][0] <= now_us:
            entry = self._entries.get(heapq.heappop(self._deadlines)[1])
            if entry is not None:
                self.drop(entry, "stale")

    def next_deadline_us(self) -> int | None:
        """When the next message becomes stale."""
        while self._deadlines and self._deadlines[0][1] not in self._entries:
            heapq.heappop(self._deadlines)
        return self._deadlines[0][0] if self._deadlines else None

    def peek(self) -> Entry | None:
        """The message whose fragment goes next."""
        while self._heap and self._heap[0][1] not in self._entries:
            heapq.heappop(self._heap)
        if not self._heap:
            return None
        best = self._entries[self._heap[0][1]]
        if best.hurries or best.started or self._started < limits.MAX_PARTIAL_MESSAGES // 2:
            return best
        return min((e for e in self._entries.values() if e.started), key=lambda e: e.rank)

    def take_fragment(self, entry: Entry, seq: int, packet_bytes: int = limits.PACKET_BYTES) -> bytes:
        """The next packet of ``entry``, numbered ``seq``, of at most ``packet_bytes``. A finished entry leaves the
        queue.
        """
        if not entry.started:
            # Among equals a message half sent goes on first, so that few are half received at any time.
            entry.rank = (entry.rank[0], entry.rank[1], -1)
            heapq.heappush(self._heap, (entry.rank, entry.ident))
            self._started += 1
        chunk = entry.chunk(packet_bytes - FRAGMENT_HEADER_BYTES)
        packet = encode(Fragment(seq, entry.ident, entry.sent, entry.size if len(chunk) < entry.size else 0), chunk)
        entry.sent += len(chunk)
        entry.unacked.add(seq)
        self.queued_bytes -= len(chunk)
        if entry.finished:
            self._forget(entry)
        return packet

    def clear(self, reason: str) -> None:
        """Drop everything."""
        for entry in list(self._entries.values()):
            self.drop(entry, reason)

    def _replace(self, entry: Entry) -> None:
        key = entry.outgoing.key
        if key is None:
            return
        old = self._by_key.get(key)
        if old is not None and not old.started:
            self.drop(old, "replaced")
        self._by_key[key] = entry

    def _forget(self, entry: Entry) -> None:
        del self._entries[entry.ident]
        self._compact()
        self.queued_bytes -= entry.size - entry.sent
        self._started -= entry.started
        if self._by_key.get(entry.outgoing.key) is entry:
            del self._by_key[entry.outgoing.key]

    def _compact(self) -> None:
        """Rid both heaps of entries that have left. Else those that never reach the top would stay in them: beside a
        message of high priority that always waits, everything of lower priority that was dropped meanwhile.
        """
        bound = 2 * len(self._entries) + SLACK_ENTRIES
        if len(self._heap) > bound:
            self._heap = [(entry.rank, ident) for ident, entry in self._entries.items()]
            heapq.heapify(self._heap)
        if len(self._deadlines) > bound:
            self._deadlines = [item for item in self._deadlines if item[1] in self._entries]
            heapq.heapify(self._deadlines)


def _dispensable(entry: Entry) -> tuple[bool, bool, Rank]:
    """The larger, the sooner a message is dropped for want of room."""
    return not isinstance(entry.outgoing.message, Blob), not entry.started, entry.rank


def _class_of(outgoing: Outgoing) -> int:
    if isinstance(outgoing.message, Mark):
        return MARKS
    if outgoing.urgent:
        return URGENT
    return REFERENCES if isinstance(outgoing.message, ReferenceFrame) else OTHERS
