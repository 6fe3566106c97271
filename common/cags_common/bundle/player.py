"""Playing a bundle in order at one LoD: what a client with every tile would hold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cags_common.bundle.reader import BundleReader
from cags_common.bundle.source import SourceDelta, SourceFrame, SourceState
from cags_common.codecs import TileDecoder, dequantise_tiles
from cags_common.errors import BundleError


@dataclass(frozen=True, eq=False)
class DecodedFrame(SourceFrame):
    """All splats alive in one frame, as decoded."""


class BundlePlayer:
    """Decodes whole frames of a bundle at one LoD. Cheapest in rising order. Not thread-safe."""

    def __init__(self, reader: BundleReader, lod: int | None = None) -> None:
        """``lod`` is the level of every tile, 0 to ``manifest.lods - 1``; None takes the highest."""
        manifest = reader.manifest
        self._lod = manifest.lods - 1 if lod is None else lod
        if not 0 <= self._lod < manifest.lods:
            raise BundleError(f"LoD {lod} is outside 0 to {manifest.lods - 1}")
        self._reader = reader
        self._at: int | None = None
        self._state = SourceState(0, 0)

    def frame(self, frame: int) -> DecodedFrame:
        """All splats of ``frame``. Raises :class:`BundleError` or :class:`DecodeError`."""
        manifest = self._reader.manifest
        gof = manifest.gof_of(frame)
        first = manifest.gof_starts[gof]
        if self._at is None or not first <= self._at <= frame:
            self._state = SourceState(manifest.capacity[gof], manifest.sh_degree)
            self._at = first - 1
        for at in range(self._at + 1, frame + 1):
            self._state.apply(self._delta(at))
            self._at = at
        state = self._state.frame()
        return DecodedFrame(state.ids, state.splats)

    def tile(self, frame: int, tile: int) -> TileDecoder:
        """One tile at this player's LoD."""
        reader = self._reader
        state = reader.codec.open_tile(reader.payload(frame, tile, 0))
        for lod in range(1, self._lod + 1):
            state.add_layer(lod, reader.payload(frame, tile, lod))
        return state

    def _delta(self, frame: int) -> SourceDelta:
        tiles = [self.tile(frame, entry.tile) for entry in self._reader.frame(frame).tiles]
        ids = np.concatenate([np.zeros(0, np.int32), *(tile.ids for tile in tiles)])
        order = np.argsort(ids, kind="stable")
        splats = dequantise_tiles(tiles, self._reader.manifest.sh_degree).take(order)
        return SourceDelta(ids[order], splats, self._reader.removed_ids(frame))
