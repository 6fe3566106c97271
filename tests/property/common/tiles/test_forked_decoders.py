"""Decoders that are copied before something is added to them, or cut down to fewer levels."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from cags_common.bundle import BundleReader
from cags_common.bundle.codecs import AnyTile, MotionTile
from cags_common.motion.chunk import Chunk
from cags_common.tiles.updates import UpdateState
from support.closed_loop import encoded_clip
from support.moving_bundle import write_moving


@cache
def bundle(kind: str) -> BundleReader:
    return write_moving("memory://forked", 3) if kind == "svq" else encoded_clip(kind)


def values(state: AnyTile) -> list[np.ndarray]:
    """All that a tile decodes to."""
    if isinstance(state, MotionTile):
        chunk: Chunk = state.chunk
        return [part.copy() for part in (chunk.moves, chunk.turns, chunk.lives, chunk.fades) if part is not None]
    if isinstance(state, UpdateState):
        return [array for change in state.values().values() for array in (change.ids, change.values, change.frames)]
    return [state.ids, *(array for _, array in state.dequantise().arrays())]


def same(one: list[Any], other: list[Any]) -> bool:
    return len(one) == len(other) and all(a.tobytes() == b.tobytes() for a, b in zip(one, other, strict=True))


def tiles(reader: BundleReader) -> list[tuple[int, int]]:
    return [(frame, tile.tile) for frame in range(reader.manifest.frames) for tile in reader.frame(frame).tiles]


@settings(max_examples=150, deadline=None)
@given(st.sampled_from(["svq", "density", "video"]), st.data())
def test_a_fork_and_its_origin_do_not_know_of_each_other(kind: str, data: st.DataObject) -> None:
    reader = bundle(kind)
    key = data.draw(st.sampled_from(tiles(reader)))
    lods = len(reader.frame(key[0]).tiles[key[1]].lod_bytes)
    order = data.draw(st.permutations(range(1, lods)))
    at = data.draw(st.integers(0, len(order)))
    one, other = (reader.open_tile(*key) for _ in range(2))
    for lod in order[:at]:
        one.add_layer(lod, reader.payload(*key, lod))
        other.add_layer(lod, reader.payload(*key, lod))
        if data.draw(st.booleans()):
            values(one)
    fork = one.fork()
    for lod in order[at:]:
        fork.add_layer(lod, reader.payload(*key, lod))
    assert same(values(one), values(other))
    assert one.lod == other.lod
    for lod in order[at:]:
        one.add_layer(lod, reader.payload(*key, lod))
    assert same(values(one), values(fork))


@settings(max_examples=150, deadline=None)
@given(st.sampled_from(["svq", "density"]), st.data())
def test_a_reduced_decoder_is_as_if_no_more_had_come(kind: str, data: st.DataObject) -> None:
    reader = bundle(kind)
    key = data.draw(st.sampled_from(tiles(reader)))
    lods = len(reader.frame(key[0]).tiles[key[1]].lod_bytes)
    whole, less = (reader.open_tile(*key) for _ in range(2))
    if isinstance(whole, MotionTile):
        return
    for lod in data.draw(st.lists(st.integers(1, lods - 1), max_size=2 * lods)) if lods > 1 else []:
        whole.add_layer(lod, reader.payload(*key, lod))
        if data.draw(st.booleans()):
            values(whole)
    kept = data.draw(st.integers(1, whole.lod + 1))
    for lod in range(1, kept):
        less.add_layer(lod, reader.payload(*key, lod))
    reduced = whole.reduced(kept)
    assert same(values(reduced), values(less))
    assert reduced.lod == less.lod
    for lod in range(1, lods):
        reduced.add_layer(lod, reader.payload(*key, lod))
        less.add_layer(lod, reader.payload(*key, lod))
    assert same(values(reduced), values(less))
