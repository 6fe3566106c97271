"""Buffer of layers that arrived before the base layer of their tile."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable

from cags_common.store.tile_decode import Key

MAX_WAITING_BYTES = 8 << 20
"""Largest size of waiting layers per group of frames, bytes."""


class WaitingLayers:
    """Waiting layers by tile; beyond :data:`MAX_WAITING_BYTES` those of the oldest tile are discarded."""

    def __init__(self, kept: Callable[[memoryview], bytes | memoryview] = bytes) -> None:
        """``kept`` converts a payload to a form that may be stored."""
        self._kept = kept
        self._layers: OrderedDict[Key, list[tuple[int, bytes | memoryview]]] = OrderedDict()
        self.bytes = 0
        """Size of all waiting layers, bytes."""

    def add(self, key: Key, layers: Iterable[tuple[int, memoryview]]) -> list[Key]:
        """Store ``layers``, (LoD, payload), until :meth:`take`; returns the tiles whose layers were discarded."""
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
        """Remove and return the layers that waited for ``key``, in order of arrival."""
        layers = self._layers.pop(key, [])
        self.bytes -= sum(len(data) for _, data in layers)
        return [(lod, memoryview(data)) for lod, data in layers]
