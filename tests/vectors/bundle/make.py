"""Write a vector file of the current bundle format: ``python tests/vectors/bundle/make.py FILE``.

A file that is committed is never written again: a change of the format adds a new one. Payloads are base64; decoded
arrays are the bits of their float32 numbers, so that a decoder must agree exactly.
"""

from __future__ import annotations

import base64
import json
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from cags_common.bundle.codecs import tile_codec
from cags_common.bundle.manifest import VERSION, Manifest
from cags_common.tiles.attributes import ATTRIBUTE_DIMS
from cags_common.tiles.contexts import ContextModel, nearest
from cags_common.tiles.lod import POSITION, LodLayer
from cags_common.tiles.payloads import PositionGrid, encode_base, encode_looks_layer, encode_position_layer
from cags_common.tiles.ramps import LONGEST_RAMP
from cags_common.tiles.svq import Codebook, CodebookSet
from cags_common.tiles.updates import RAMP_COLUMNS, Change, UpdateState, encode_update

SPLATS = 83
STAGES = {
    "scale": ((4, 2), (2, 1)),
    "rotation": ((4,), (3,)),
    "alpha": ((4, 2), ()),
    "sh0": ((3, 1), ()),
    "sh1": ((1, 8), ()),
}
MODELLED = {"scale": (0, 1), "rotation": (0, 1), "sh0": (1,)}
"""Layers whose codes are coded by context."""
CLOUDS = {"a key frame's tile": True, "a later frame's tile": False}
POSITION_LAYERS = {True: 3, False: 2}
"""Layers of positions of a key frame's tile, as many as the order has, and of a later frame's, which has fewer."""


def books() -> CodebookSet:
    """Two-stage and one-stage trees over simple fractions."""
    random = np.random.default_rng(1)

    def table(bits: int, attribute: str) -> np.ndarray:
        return (random.integers(-64, 64, (1 << bits, ATTRIBUTE_DIMS[attribute])) / 64).astype(np.float32)

    made = {}
    for name, (first, second) in STAGES.items():
        tables = tuple(table(int(bits), name) for stage in (first, second) for bits in np.cumsum(stage))
        shape = (1 << sum(first), ATTRIBUTE_DIMS[name])
        words = random.integers(0, 31 << 3, shape).astype(np.uint16) << 7  # every positive float16 of 3 bits
        spreads = words.view(np.float16).astype(np.float32) if second else None
        models = tuple(
            _model(first + second, layer, random) if layer in MODELLED.get(name, ()) else None for layer in (0, 1)
        )
        made[name] = Codebook(name, first + second, tables, len(first), spreads, models)
    return CodebookSet(made)


def _model(bits: tuple[int, ...], layer: int, random: np.random.Generator) -> ContextModel:
    """Weights with which zeros are likely, and a row of zeros."""
    shape = ContextModel.shape_of(bits[layer], sum(bits[:layer]))
    weights = random.integers(0, 12, shape).astype(np.uint8)
    weights[:, 0] = random.integers(100, 256, shape[0])
    weights[1] = 0
    return ContextModel(bits[layer], sum(bits[:layer]), weights)


def manifest(codebooks: CodebookSet) -> Manifest:
    """The fields that a tile codec reads, and legal ones for the rest."""
    layers = {
        **{book.attribute: book.enhancement_layers for book in codebooks},
        POSITION: max(POSITION_LAYERS.values()),
    }
    order = tuple(LodLayer(name, layer) for layer in (1, 2, 3) for name, most in layers.items() if layer <= most)
    return Manifest("vector", 30.0, 1, (0,), (99,), 1, ((0, 0, 0), (1, 1, 1)), order, ())


def _codes(book: Codebook, random: np.random.Generator) -> np.ndarray:
    """Codes of full length, of which every layer is mostly zero, so that contexts make them shorter."""
    codes = np.zeros(SPLATS, np.uint32)
    for bits in book.layer_bits:
        codes = codes << np.uint32(bits) | np.where(
            random.random(SPLATS) < 0.2, random.integers(0, 1 << bits, SPLATS), 0
        )
    return codes.astype(np.uint32)


def payloads(codebooks: CodebookSet, *, id_range: bool) -> list[bytes]:
    """One tile's, LoD by LoD."""
    random = np.random.default_rng(2)
    means = random.normal(size=(SPLATS, 3)).astype(np.float32)
    ids = np.arange(7, 7 + SPLATS, dtype=np.int32) * (1 if id_range else 3)
    codes = {b.attribute: _codes(b, random) for b in codebooks}
    base = {book.attribute: book.layer(codes[book.attribute], 0) for book in codebooks}
    grid = PositionGrid.over(means, 12, POSITION_LAYERS[id_range])
    out, near = [encode_base(ids, means, base, grid, codebooks, id_range=id_range)], nearest(grid.coarse(means))
    for item in manifest(codebooks).lod_order:
        if item.attribute == POSITION:
            out.append(encode_position_layer(means, grid, item.layer))
            continue
        out.append(encode_looks_layer(codebooks[item.attribute], item.layer, codes[item.attribute], near))
    return out


def vector() -> dict[str, Any]:
    """Everything of the file."""
    codebooks = books()
    info, data = manifest(codebooks), codebooks.to_bytes()
    clouds = []
    for name, id_range in CLOUDS.items():
        tile = payloads(codebooks, id_range=id_range)
        clouds.append({"name": name, "payloads": [_text(part) for part in tile], "decoded": _decoded(info, data, tile)})
    changed = update(codebooks)
    return {
        "version": VERSION,
        "manifest": json.loads(info.to_json()),
        "codebooks": _text(data),
        "tiles": clouds,
        "update": {"payloads": [_text(part) for part in changed], "values": _values(info, data, changed)},
    }


def update(codebooks: CodebookSet) -> list[bytes]:
    """An update of some attributes of some splats, LoD by LoD."""
    random = np.random.default_rng(3)
    ids = np.arange(4, 4 + 2 * SPLATS, 2, dtype=np.int32)
    rows = np.arange(SPLATS)
    changed = {"scale": rows % 3 == 0, "rotation": rows < 0, "alpha": rows > 4, "sh0": rows % 2 == 1, "sh1": rows == 2}
    codes = {b.attribute: random.integers(0, 1 << sum(b.layer_bits), SPLATS).astype(np.uint32) for b in codebooks}
    frames = {c: random.integers(1, LONGEST_RAMP + 1, SPLATS).astype(np.uint8) for c in RAMP_COLUMNS}
    return list(encode_update(ids, changed, codes, codebooks, manifest(codebooks).lod_order, frames))


def _values(info: Manifest, codebooks: bytes, payloads: list[bytes]) -> list[dict[str, dict[str, str]]]:
    """What an update says at LoD 0 and at the highest, by column: ids and values."""
    state = tile_codec(info, codebooks).open_tile(payloads[0])
    assert isinstance(state, UpdateState)
    out = []
    for first, end in pairwise((0, 1, len(payloads))):
        for lod in range(max(first, 1), end):
            state.add_layer(lod, payloads[lod])
        changes = state.values().items()
        out.append({column: _change(change) for column, change in changes})
    return out


def _change(change: Change) -> dict[str, str]:
    return {
        "ids": _text(change.ids.astype("<i4").tobytes()),
        "rows": _text(change.values.tobytes()),
        "frames": _text(change.frames.tobytes()),
    }


def _decoded(info: Manifest, codebooks: bytes, tile: list[bytes]) -> list[dict[str, str]]:
    """Arrays at LoD 0 and at the highest."""
    state = tile_codec(info, codebooks).open_tile(tile[0])
    out = []
    for first, end in pairwise((0, 1, len(tile))):
        for lod in range(max(first, 1), end):
            state.add_layer(lod, tile[lod])
        arrays = {name: _text(array.astype("<f4").tobytes()) for name, array in state.dequantise().arrays()}
        out.append({"ids": _text(state.ids.astype("<i4").tobytes()), **arrays})
    return out


def _text(data: bytes) -> str:
    return base64.b64encode(data).decode()


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(json.dumps(vector(), indent=1) + "\n")
