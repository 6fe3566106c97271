"""One quantiser on one scene: bytes, quality and times of its LoDs, and of a frame of changed splats."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from cags_bench.codec.ablation import Variant
from cags_bench.codec.views import Judge
from cags_common.bundle import Manifest
from cags_common.bundle.codecs import tile_codec
from cags_common.errors import DecodeError
from cags_common.raster import create
from cags_common.splats import Splats
from cags_common.store.tile_decode import First, OpenTile, TileOpener
from cags_common.tiles.morton import tile_ranges
from cags_common.tiles.payloads import KEY_TILE_SPLATS, position_bytes
from cags_encoder.codecs.svq import SvqCodec
from cags_encoder.measuring import VIEWS, measure
from cags_encoder.quantiser.importance import VIEWS as IMPORTANCE_VIEWS
from cags_encoder.quantiser.importance import importance
from cags_encoder.scenes import FrameSource
from cags_encoder.views import cameras_around

Line = dict[str, Any]
Tile = tuple[bytes, ...]
"""Payloads by LoD."""

TRAIN_SPLATS = 65_536
CHANGED_SPLATS = 4_000
"""Number of changed splats in the differential frame whose decoding is timed."""


@dataclass(frozen=True)
class LadderSettings:
    """Settings of a measurement."""

    points: int
    """LoDs to render."""
    repeats: int
    """Timed runs after a warm-up."""
    threads: int
    """Decoding threads."""


def ladder(
    source: FrameSource, splats: Splats, variant: Variant, judge: Judge, settings: LadderSettings
) -> Iterator[Line]:
    """One line per LoD. ``splats`` are in Morton order."""
    start = time.perf_counter()
    codec = train(source, splats, variant)
    train_s = time.perf_counter() - start
    tiles, books = encode(codec, splats), codec.codebooks()
    changed = encode_changed(codec, splats)
    opener = TileOpener(tile_codec(_manifest(codec), books), settings.threads)
    common = {
        "train_s": train_s,
        "encode_ms": median_ms(partial(encode, codec, splats), 1),
        "changed_splats": min(CHANGED_SPLATS, len(splats)),
        "changed_bytes": sum(map(len, changed)),
        "changed_decode_ms": median_ms(
            partial(decode, opener, [changed], len(codec.lod_order), splats.sh_degree), 5 * settings.repeats
        ),
    }
    for lod in np.unique(np.linspace(0, len(codec.lod_order), settings.points).astype(int)):
        shown = partial(decode, opener, tiles, int(lod), splats.sh_degree)
        yield {
            "codec": variant.name,
            "lod": int(lod),
            **sizes(tiles, int(lod), len(books), len(splats)),
            **asdict(judge(shown())),
            **common,
            "decode_ms": median_ms(shown, settings.repeats),
        }


def train(source: FrameSource, splats: Splats, variant: Variant) -> SvqCodec:
    """Codebooks trained on a sample and, if a rasteriser is available, the measured LoD order."""
    rows = np.sort(np.random.default_rng(0).permutation(len(splats))[:TRAIN_SPLATS])
    samples, rasteriser = splats.take(rows), create("auto")
    if rasteriser.name == "oracle":
        return SvqCodec.train(samples, variant.settings, None, variant.config).modelled(splats)
    around = cameras_around(source.focus, source.up, IMPORTANCE_VIEWS)
    weights = importance(samples, around, rasteriser) if variant.weighted else None
    codec = SvqCodec.train(samples, variant.settings, weights, variant.config).modelled(splats)
    if not variant.measured:
        return codec
    cameras = cameras_around(source.focus, source.up, VIEWS)
    still, refine = np.ones(len(splats), np.bool_), variant.settings.measures_positions
    found = measure(codec, splats, cameras, rasteriser, lambda at, end: None, still=still, refine=refine)
    return found.applied(codec)


def encode(codec: SvqCodec, splats: Splats) -> list[Tile]:
    """All splats as a key frame."""
    coded = codec.quantise(codec.prepare(splats))
    return [
        codec.encode_tile(np.arange(first, end, dtype=np.int32), coded.take(slice(first, end)), id_range=True)
        for first, end in tile_ranges(len(splats), KEY_TILE_SPLATS)
    ]


def encode_changed(codec: SvqCodec, splats: Splats) -> Tile:
    """A tile of a differential frame: scattered splats with ids, as a moving object causes."""
    count = min(CHANGED_SPLATS, len(splats))
    ids = np.sort(np.random.default_rng(0).permutation(len(splats))[:count]).astype(np.int32)
    return codec.encode_tile(ids, codec.quantise(codec.prepare(splats.take(ids))), id_range=False)


def decode(opener: TileOpener, tiles: list[Tile], lod: int, sh_degree: int) -> Splats:
    """The splats that a client shows from ``tiles`` up to ``lod``."""
    states, firsts = [], [First((0, number), 0, memoryview(tile[0])) for number, tile in enumerate(tiles)]
    for opened, payloads in zip(opener.opened(firsts), tiles, strict=True):
        if isinstance(opened, DecodeError):
            raise opened
        assert isinstance(opened, OpenTile)  # a static scene has only looks
        for level in range(1, lod + 1):
            opened.state.add_layer(level, payloads[level])
        states.append(opened.state)
    return opener.merged(states, sh_degree)


def sizes(tiles: list[Tile], lod: int, codebooks: int, splats: int) -> Line:
    """Bytes up to ``lod``, in total and by part."""
    positions = sum(position_bytes(payloads[0]) for payloads in tiles)
    base = sum(len(payloads[0]) for payloads in tiles)
    total = sum(len(payload) for payloads in tiles for payload in payloads[: lod + 1])
    return {
        "splats": splats,
        "bytes": total + codebooks,
        "bytes_a_splat": total / splats,
        "bytes_positions": positions,
        "bytes_base": base - positions,
        "bytes_layers": total - base,
        "bytes_codebooks": codebooks,
    }


def median_ms(work: Callable[[], object], repeats: int) -> float:
    """Median of ``repeats`` runs after one warm-up."""
    work()
    taken = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        taken.append(1e3 * (time.perf_counter() - start))
    return statistics.median(taken)


def _manifest(codec: SvqCodec) -> Manifest:
    degree = codec.quantiser.books.sh_degree
    return Manifest("", 30.0, 1, (0,), (0,), degree, ((0, 0, 0), (0, 0, 0)), codec.lod_order, ())
