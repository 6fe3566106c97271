"""The parts of a frame's encoding that depend on no other frame, so that any worker can run them."""

from __future__ import annotations

from typing import TypeAlias

from cags_common.bundle import TilePayloads
from cags_common.bundle.source import encode_source
from cags_common.splats import Splats
from cags_common.tiles.kinds import TileKind
from cags_common.tiles.updates import encode_update
from cags_encoder.codecs.registry import ClipCodec
from cags_encoder.codecs.svq import SvqCodec
from cags_encoder.execution.executors import Shared
from cags_encoder.frames.differential import QuantisedDelta
from cags_encoder.frames.moving import UpdateCut
from cags_encoder.motion.chunks import TrackSpan, encode_span
from cags_encoder.scenes import FrameSource
from cags_encoder.tiling import CutTile
from cags_encoder.tracks.effect import visible_effect
from cags_encoder.tracks.looking import Look
from cags_encoder.tracks.placing import Placed

AnyCut: TypeAlias = CutTile | UpdateCut | TrackSpan
"""Content of a frame, before packing."""


def look(source: Shared[FrameSource], index: int) -> Look:
    """Read frame ``index`` and its identities."""
    frames = source.get()
    return Look(frames.frame(index), frames.ids(index))


def read(source: Shared[FrameSource], index: int) -> Splats:
    """Read frame ``index``."""
    return source.get().frame(index)


def quantise(codec: Shared[ClipCodec], frame: Placed) -> QuantisedDelta:
    """Quantise all changes of a frame."""
    machine = codec.get()
    prepared = machine.prepare(frame.delta.splats)
    coded = machine.quantise(prepared)
    effect = None if frame.key else visible_effect(machine.decode(coded), prepared)
    return QuantisedDelta(prepared, coded, effect, encode_source(frame.source))


def quantise_looks(codec: Shared[ClipCodec], frame: Placed) -> QuantisedDelta:
    """Quantise the new splats of a frame."""
    machine = codec.get()
    assert frame.told is not None
    prepared = machine.prepare(frame.told.splats)
    return QuantisedDelta(prepared, machine.quantise(prepared), None, encode_source(frame.source))


def pack(codec: Shared[ClipCodec], tiles: tuple[AnyCut, ...]) -> tuple[TilePayloads, ...]:
    """Payloads of a frame's tiles."""
    return tuple(_packed(codec.get(), tile) for tile in tiles)


def _packed(codec: ClipCodec, tile: AnyCut) -> TilePayloads:
    if isinstance(tile, TrackSpan):
        return encode_span(tile)
    if isinstance(tile, UpdateCut):
        assert isinstance(codec, SvqCodec)
        books, order = codec.quantiser.books, codec.lod_order
        payloads = encode_update(tile.ids, tile.changed, tile.coded.codes, books, order, tile.frames)
        return TilePayloads(len(tile.ids), None, tile.bounds, payloads, TileKind.UPDATE)
    payloads = codec.encode_tile(tile.ids, tile.coded, id_range=tile.id_range)
    return TilePayloads(len(tile.ids), int(tile.ids[0]) if tile.id_range else None, tile.bounds, payloads)
