"""Layers that have come before the base layer of their tile."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable

from cags_common.store.tile_decode import Key

MAX_WAITING_BYTES = 8 << 20
"""Bound on layers that wait for their tile's base, a group of frames."""


class WaitingLayers:
    """Layers by tile; the oldest tile's go when more than :data:`MAX_WAITING_BYTES` wait."""

    def __init__(self, kept: Callable[[memoryview], bytes | memoryview] = bytes) -> None:
        """``kept`` makes of a payload what may stay."""
        self._kept = kept
        self._layers: OrderedDict[Key, list[tuple[int, bytes | memoryview]]] = OrderedDict()
        self.bytes = 0
        """Bytes of all that waits."""

    def add(self, key: Key, layers: Iterable[tuple[int, memoryview]]) -> list[Key]:
        """Keep ``layers``, (LoD, payload), until :meth:`take`. The tiles whose layers made room for them."""
        kept = self._layers.setdefault(key, [])
        for lod, payload in layers:
            kept.append((lod, self._kept(payload)))
            self.bytes += len(payload)
        gone = []
        while self.bytes > MAX_WAITING_BYTES:
            oldest, dropped = self._layers.popitem(last=False)
            self.bytes -= sum(len(data) for _, data in dropped)
            gone.append(oldest)
        return gone

    def take(self, key: Key) -> list[tuple[int, memoryview]]:
        """The layers that waited for ``key``, in the order of their arrival."""
        layers = self._layers.pop(key, [])
        self.bytes -= sum(len(data) for _, data in layers)
        return [(lod, memoryview(data)) for lod, data in layers]
