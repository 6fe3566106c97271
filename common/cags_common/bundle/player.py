"""Playing a bundle in order at one LoD: what a client with every tile would hold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cags_common.bundle.codecs import AnyTile, MotionTile
from cags_common.bundle.index import TileEntry
from cags_common.bundle.reader import BundleReader
from cags_common.bundle.source import SourceFrame
from cags_common.errors import BundleError, DecodeError
from cags_common.motion.apply import ABSENT_LOGIT
from cags_common.tiles.kinds import TileKind
from cags_common.tiles.splat_buffer import Slot, SplatBuffer
from cags_common.tiles.updates import UpdateState


@dataclass(frozen=True, eq=False)
class DecodedFrame(SourceFrame):
    """All splats alive in one frame, as decoded."""


class BundlePlayer:
    """Decodes whole frames of a bundle at one LoD. Cheapest in rising order. Not thread-safe."""

    def __init__(self, reader: BundleReader, lod: int | None = None) -> None:
        """``lod`` is the level of every tile, 0 to ``manifest.lods - 1``; None takes the highest.

        Motion goes with it, to the same share of its own levels, rounded up.
        """
        manifest = reader.manifest
        self._lod = manifest.lods - 1 if lod is None else lod
        if not 0 <= self._lod < manifest.lods:
            raise BundleError(f"LoD {lod} is outside 0 to {manifest.lods - 1}")
        self._reader = reader
        self._at: int | None = None
        self._buffer = SplatBuffer(0, 0)

    def frame(self, frame: int) -> DecodedFrame:
        """All splats of ``frame``. Raises :class:`BundleError` or :class:`DecodeError`."""
        manifest = self._reader.manifest
        gof = manifest.gof_of(frame)
        first = manifest.gof_starts[gof]
        if self._at is None or not first <= self._at <= frame:
            self._buffer = SplatBuffer(manifest.capacity[gof], manifest.sh_degree)
            self._at = first - 1
        for at in range(self._at + 1, frame + 1):
            self._take(at, float(frame))
            self._at = at
        self._buffer.move(float(frame))
        self._buffer.ramp(float(frame))
        splats = self._buffer.splats
        alive = (self._buffer.owner >= 0) & (splats.logit_opacities > ABSENT_LOGIT)
        ids = np.flatnonzero(alive).astype(np.int32)
        return DecodedFrame(ids, splats.take(ids))

    def tile(self, frame: int, entry: TileEntry) -> AnyTile:
        """One tile at this player's LoD."""
        reader, number = self._reader, entry.tile
        state = reader.open_tile(frame, number)
        top, levels = reader.manifest.lods - 1, len(entry.lod_bytes)
        if entry.kind == TileKind.MOTION:
            levels = sum(size > 0 for size in entry.lod_bytes)
        for lod in range(1, -(-self._lod * (levels - 1) // max(top, 1)) + 1):
            state.add_layer(lod, reader.payload(frame, number, lod))
        return state

    def _take(self, frame: int, time: float) -> None:
        """What ``frame`` brings, in the order in which a client commits it to show ``time``."""
        if self._reader.manifest.motion is None:
            self._buffer.remove(frame, self._reader.removed_ids(frame))
        for entry in self._reader.frame(frame).tiles:
            state = self.tile(frame, entry)
            if isinstance(state, MotionTile):
                self._buffer.set_motion(_fitting(state, entry), frame, state.chunk)
                continue
            self._reader.within(state.ids, frame, f"tile {entry.tile}")
            if isinstance(state, UpdateState):
                self._buffer.update(frame, state.values(), time)
            else:
                slot = Slot(len(self._buffer.slots), (frame, entry.tile), steps=state.steps)
                self._buffer.add(slot)
                self._buffer.write(slot, self._lod, state.ids, state.dequantise())


def _fitting(state: MotionTile, entry: TileEntry) -> tuple[int, int]:
    """The looks that ``state`` moves, where the index says the same. Raises :class:`DecodeError`."""
    if state.looks != entry.looks:
        raise DecodeError(f"tile {entry.tile}: moves {state.looks}, its index says {entry.looks}")
    return state.looks
