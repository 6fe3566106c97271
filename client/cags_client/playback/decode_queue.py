"""Media that has come over the wire: in line to be decoded, being decoded, and counted until the next picture."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from cags_client.playback.jobs import DataEvent, Restarted, Traffic
from cags_common.tiles.inventory import InventoryEntry
from cags_protocol import events as ev

DECODE_BATCH = 32
"""Messages decoded in one go: enough to dequantise a tile once for all its layers, few enough to stay prompt."""

MAX_UNDECODED_BYTES = 32 << 20
"""Media that may wait for its decoder; beyond it a client stops reading, and acknowledging, until it has caught up."""


class DecodeQueue:
    """The line of what waits for its decoder. One batch is out at a time."""

    def __init__(self) -> None:
        self.decoding: tuple[DataEvent, ...] = ()
        """The batch that is being decoded."""
        self._waiting: deque[DataEvent] = deque()
        self._tile_bytes = self._reference_bytes = 0
        self._waiting_bytes = self._decoding_bytes = 0
        self.quiet = True
        """Whether nothing has come, and nothing been decoded, since :meth:`traffic` was asked last."""

    @property
    def undecoded_bytes(self) -> int:
        """Payloads that wait or are being decoded."""
        return self._waiting_bytes + self._decoding_bytes

    def add(self, event: DataEvent) -> None:
        """The next in line."""
        self._waiting.append(event)
        self.quiet = False
        self._waiting_bytes += _size(event)
        match event:
            case ev.TileReceived(_, payload):
                self._tile_bytes += len(payload)
            case ev.ReferenceReceived(_, payload):
                self._reference_bytes += len(payload)

    def take(self, *, tiles: bool = True) -> tuple[DataEvent, ...]:
        """The next batch, and :meth:`decoded` when it is done; empty while one is out. Without ``tiles`` it ends before
        the first of these.
        """
        if self.decoding:
            return ()
        count = min(len(self._waiting), DECODE_BATCH)
        if not tiles:
            held = (at for at, event in enumerate(self._waiting) if isinstance(event, ev.TileReceived))
            count = min(count, next(held, count))
        self.decoding = tuple(self._waiting.popleft() for _ in range(count))
        self._decoding_bytes = sum(map(_size, self.decoding))
        self._waiting_bytes -= self._decoding_bytes
        return self.decoding

    def decoded(self) -> None:
        """The batch that was out is in the store: a picture begun before shows it not, or in part."""
        self.quiet = self.quiet and not self.decoding
        self.decoding = ()
        self._decoding_bytes = 0

    def clear(self) -> None:
        """What waits is of no use any more, but for the beginnings of connections, by which marks are told apart."""
        self._waiting = deque(event for event in self._waiting if isinstance(event, Restarted))
        self._waiting_bytes = 0

    def traffic(self) -> Traffic:
        """What has come since this was asked last."""
        traffic = Traffic(self._tile_bytes, self._reference_bytes)
        self._tile_bytes = self._reference_bytes = 0
        self.quiet = True
        return traffic

    def held(self, stored: Iterable[InventoryEntry]) -> list[InventoryEntry]:
        """What a store holds once everything here is decoded into it; a layer without the one below it is not held."""
        lods = {(tile.frame, tile.tile): tile.lods for tile in stored}
        for event in (*self.decoding, *self._waiting):
            if isinstance(event, ev.TileReceived):
                key = event.message.frame, event.message.tile
                if event.message.from_lod <= lods.get(key, 0):
                    lods[key] = max(lods.get(key, 0), event.message.to_lod)
        return [InventoryEntry(frame, tile, count) for (frame, tile), count in lods.items()]


def _size(event: DataEvent) -> int:
    return 0 if isinstance(event, Restarted | ev.MarkReceived) else len(event.payload)
