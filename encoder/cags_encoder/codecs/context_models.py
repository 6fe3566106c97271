"""Models of codes by context, learnt from tiles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cags_common.coding.packing import U32, gzip_numbers
from cags_common.tiles.contexts import (
    I32,
    ContextModel,
    can_be_modelled,
    counted,
)
from cags_common.tiles.svq import MODELLED_LAYERS, Codebook, CodebookSet

LEAST_SAVED_BITS = 0.2
"""What a model saves of each code at least: as many bits as 30 Mbit/s bring while one is decoded by context."""

Tile = tuple[Mapping[str, U32], I32]
"""Attribute -> codes [n] of full length, and the near ones [n, 2]."""


def models_of(
    books: CodebookSet, dense: Sequence[Tile], sparse: Sequence[Tile]
) -> dict[str, tuple[ContextModel | None, ...]]:
    """Attribute -> models of its first layers, where they pay for the ``dense`` tiles of a key frame.

    They are learnt from the ``sparse`` tiles, too, of which they know how unlike splats are that lie further apart.
    """
    return {book.attribute: _models(book, [*dense, *sparse], len(dense)) for book in books} if dense else {}


def _models(book: Codebook, tiles: Sequence[Tile], dense: int) -> tuple[ContextModel | None, ...]:
    models: list[ContextModel | None] = []
    for layer in range(min(len(book.layer_bits), MODELLED_LAYERS)):
        if not can_be_modelled(book.layer_bits, layer):
            break
        models.append(_model(book, layer, tiles, dense))
    while models and models[-1] is None:
        models.pop()
    return tuple(models)


def _model(book: Codebook, layer: int, tiles: Sequence[Tile], dense: int) -> ContextModel | None:
    """The model of one layer; None where it saves too little of the first ``dense`` tiles."""
    bits, prefix_bits = book.layer_bits[layer], sum(book.layer_bits[:layer])
    blank = ContextModel(bits, prefix_bits, np.zeros(ContextModel.shape_of(bits, prefix_bits), np.uint8))
    counts = [_counts(blank, book, layer, tile) for tile in tiles]
    model = ContextModel.of(np.sum(counts, axis=0), bits, prefix_bits)
    seen = np.sum(counts[:dense], axis=0)
    taken = float((model.costs * seen).sum()) + 8 * _bytes_of(model)
    return model if taken < (bits - LEAST_SAVED_BITS) * seen.sum() else None


def _counts(blank: ContextModel, book: Codebook, layer: int, tile: Tile) -> np.ndarray:
    codes, near = tile[0][book.attribute], tile[1]
    prefixes = book.prefix(codes, layer).astype(np.uint8) if layer else None
    return counted(blank, book.layer(codes, layer), prefixes, near)


def _bytes_of(model: ContextModel) -> int:
    return len(gzip_numbers(model.weights.tobytes()))
