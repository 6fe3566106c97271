"""The work on one frame that depends on no other frame's result: it runs wherever an executor puts it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle import SourceDelta, TilePayloads
from cags_common.bundle.source import encode_source
from cags_common.splats import Ids, Splats
from cags_encoder.codecs import ClipCodec
from cags_encoder.executors import Shared
from cags_encoder.frames.differential import QuantisedDelta
from cags_encoder.frames.effect import visible_effect
from cags_encoder.frames.identity import match_rows
from cags_encoder.frames.tiling import CutTile
from cags_encoder.scenes import FrameSource


@dataclass(frozen=True, eq=False)
class Look:
    """One frame as its source gives it, and how it connects to the one before."""

    splats: Splats  # [n]
    known: Ids | None  # [n] the source's own identities
    rows: NDArray[np.int64] | None  # [n] row of the frame before, or -1; None for known identities and the first frame


def look(source: Shared[FrameSource], index: int) -> Look:
    """Read frame ``index``; where its source knows no identities, match it with the frame before."""
    frames = source.get()
    splats, known = frames.frame(index), frames.ids(index)
    unmatched = known is not None or index == 0
    return Look(splats, known, None if unmatched else match_rows(frames.frame(index - 1), splats))


def read(source: Shared[FrameSource], index: int) -> Splats:
    """Frame ``index``."""
    return source.get().frame(index)


def quantise(codec: Shared[ClipCodec], delta: SourceDelta, key: bool) -> QuantisedDelta:
    """Quantise all that a frame changes."""
    machine = codec.get()
    prepared = machine.prepare(delta.splats)
    coded = machine.quantise(prepared)
    effect = None if key else visible_effect(machine.decode(coded), prepared)
    return QuantisedDelta(prepared, coded, effect, encode_source(delta))


def pack(codec: Shared[ClipCodec], tiles: tuple[CutTile, ...]) -> tuple[TilePayloads, ...]:
    """Payloads of a frame's tiles."""
    machine, out = codec.get(), []
    for tile in tiles:
        payloads = machine.encode_tile(tile.ids, tile.coded, id_range=tile.id_range)
        out.append(TilePayloads(len(tile.ids), int(tile.ids[0]) if tile.id_range else None, tile.bounds, payloads))
    return tuple(out)
