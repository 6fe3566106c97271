"""A bundle's bytes by kind of tile and by part."""

from __future__ import annotations

from collections import Counter

from cags_common.bundle import BundleReader
from cags_common.bundle.index import TileEntry
from cags_common.motion.chunk import spent
from cags_common.tiles.kinds import TileKind
from cags_common.tiles.payloads import base_parts
from cags_common.tiles.updates import update_parts

MOST_CHUNKS = 8
"""Number of chunks of motion whose symbols are counted by part, which is slow; their shares represent all chunks."""

Parts = dict[str, dict[str, int]]


def byte_parts(reader: BundleReader) -> Parts:
    """Bytes of all tiles except key frames' looks: kind -> part -> bytes. Raises :class:`BundleError`."""
    found = {kind: Counter[str]() for kind in TileKind}
    chunks = []
    for frame in range(reader.manifest.frames):
        entry = reader.frame(frame)
        for tile in entry.tiles:
            if tile.kind == TileKind.MOTION:
                chunks.append((frame, tile))
            elif not (entry.keyframe and tile.kind == TileKind.LOOKS):
                _add_attributes(found[tile.kind], reader, frame, tile)
    found[TileKind.MOTION] = _motion(reader, chunks)
    return {kind.name.lower(): {k: v for k, v in parts.items() if v} for kind, parts in found.items() if parts}


def _add_attributes(to: Counter[str], reader: BundleReader, frame: int, tile: TileEntry) -> None:
    """Add the bytes of a tile of looks, or of an update."""
    base = reader.payload(frame, tile.tile, 0)
    to.update(base_parts(base) if tile.kind == TileKind.LOOKS else update_parts(base))
    for item, size in zip(reader.manifest.lod_order, tile.lod_bytes[1:], strict=True):
        to[f"{item.attribute}, finer"] += size


def _motion(reader: BundleReader, chunks: list[tuple[int, TileEntry]]) -> Counter[str]:
    """Bytes of ``chunks`` by part, from the shares in the largest of them."""
    sizes = [sum(tile.lod_bytes) for _, tile in chunks]
    judged = Counter[str]()
    for at in sorted(range(len(chunks)), key=lambda at: -sizes[at])[:MOST_CHUNKS]:
        frame, tile = chunks[at]
        levels = [lod for lod, size in enumerate(tile.lod_bytes) if size]
        assert tile.looks is not None
        payloads = [reader.payload(frame, tile.tile, lod) for lod in levels]
        judged.update(spent(payloads, reader.anchors(*tile.looks)))
    more = sum(sizes) / max(judged.total(), 1)
    return Counter({name: round(size * more) for name, size in judged.items()})
