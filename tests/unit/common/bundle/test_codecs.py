"""Tiles of every kind, opened by a codec or a reader: motion needs the looks that it moves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cags_common.bundle.codecs import MotionTile, SvqTileCodec, anchors_of
from cags_common.errors import BundleError, DecodeError
from cags_common.motion.chunk import LEVELS, encode
from cags_common.tiles.kinds import TileKind
from cags_common.tiles.state import TileState
from cags_common.tiles.svq import CodebookSet
from cags_common.tiles.updates import UpdateState
from support.anchors import scattered, together
from support.small_motion import (
    MOVE_UNIT,
    Clip,
    decoded_anchors,
    looks,
    motion,
    moving,
    random_frames,
    recoloured,
    written,
)
from support.small_store import base, books, manifest


@pytest.fixture
def clip(tmp_path: Path) -> Clip:
    frames = [[looks([0, 1], 5.0), motion((0, 0), 2, [0, 1, 2, 3])], [recoloured([1], 6)], [], []]
    return written(tmp_path, moving(manifest(4, (0,))), frames)


def test_a_reader_opens_tiles_of_every_kind(clip: Clip) -> None:
    kinds = [type(clip.reader.open_tile(*key)) for key in ((0, 0), (0, 1), (1, 0))]
    assert kinds == [TileState, MotionTile, UpdateState]
    chunk = clip.reader.open_tile(0, 1)
    assert isinstance(chunk, MotionTile) and chunk.looks == (0, 0) and len(chunk) == 2


def test_anchors_are_what_the_looks_decode_to(clip: Clip) -> None:
    anchors, wanted = clip.reader.anchors(0, 0), decoded_anchors(clip.reader.manifest, clip.frames[0][0])
    for name in ("positions", "moves", "turns"):
        assert np.array_equal(getattr(anchors, name), getattr(wanted, name))
    assert anchors.positions[:, 0].tolist() == [5, 5]
    assert anchors.moves.tolist() == [2 * MOVE_UNIT] * 2, "splats of scale code 1"


def test_anchors_are_kept_until_the_reader_is_closed(clip: Clip) -> None:
    first = clip.reader.anchors(0, 0)
    clip.reader.open_tile(0, 1)
    assert clip.reader.anchors(0, 0) is first
    clip.reader.close()
    assert clip.reader.anchors(0, 0) is not first


@pytest.mark.parametrize("key", [(0, 1), (1, 0)])
def test_tiles_that_are_no_looks_have_no_anchors(clip: Clip, key: tuple[int, int]) -> None:
    with pytest.raises((BundleError, DecodeError), match=r"no tile of looks|without the looks"):
        clip.reader.anchors(*key)


def test_nothing_moves_in_a_bundle_without_units_of_motion(tmp_path: Path) -> None:
    still = written(tmp_path, manifest(4, (0,)), [[looks([0, 1], 5.0)], [], [], []])
    with pytest.raises(BundleError, match=r"^frame 0, tile 0: no tile of looks that could move$"):
        still.reader.anchors(0, 0)
    codec = SvqTileCodec(manifest(), books().to_bytes())
    assert anchors_of(codec.open_tile(base([0], 5))) is None  # type: ignore[arg-type]


def test_motion_cannot_be_read_without_its_looks_or_on_others() -> None:
    codec, chunk = SvqTileCodec(moving(), books().to_bytes()), motion((0, 0), 2, [0, 1])
    with pytest.raises(DecodeError, match=r"^motion: cannot be read without the looks that it moves$"):
        codec.open_tile(chunk.payloads[0])
    with pytest.raises(DecodeError, match=r"^motion: 2 splats move, and the looks have 3$"):
        codec.open_tile(chunk.payloads[0], together(3))
    assert len(codec.open_tile(chunk.payloads[0], together(2))) == 2


def test_looks_and_updates_are_opened_with_anchors_or_without() -> None:
    codec = SvqTileCodec(moving(), books().to_bytes())
    for payload in (looks([0, 1], 5.0).payloads[0], recoloured([0, 1], 6).payloads[0]):
        for anchors in (None, together(2)):
            assert len(codec.open_tile(payload, anchors)) == 2


def test_levels_of_motion_may_come_in_any_order_and_a_fork_stands_alone() -> None:
    random, anchors = np.random.default_rng(0), scattered(40)
    moves, turns = (np.cumsum(random.normal(size=(9, 40, parts)), axis=0) * 20 for parts in (3, 4))
    payloads = encode((0, 0), anchors, moves, turns, starts=True)
    whole, other = (MotionTile(payloads[0], anchors) for _ in range(2))
    for level in range(1, LEVELS):
        whole.add_layer(level, payloads[level])
    fork = other.fork()
    assert not fork.add_layer(3, payloads[3]) and not fork.add_layer(2, payloads[2])
    assert fork.add_layer(1, payloads[1]) and fork.lod == LEVELS - 1 and other.lod == 0
    assert np.array_equal(fork.chunk.moves, whole.chunk.moves) and np.array_equal(fork.chunk.turns, whole.chunk.turns)
    assert not np.array_equal(other.chunk.moves, whole.chunk.moves)


@pytest.mark.parametrize("seed", range(4))
def test_every_tile_of_a_clip_is_read_on_its_own_looks(seed: int, tmp_path: Path) -> None:
    of = moving(manifest(10, (0, 5)))
    clip = written(tmp_path, of, random_frames(np.random.default_rng(seed), of))
    kinds = set()
    for frame, tiles in enumerate(clip.frames):
        for entry, tile in zip(clip.reader.frame(frame).tiles, tiles, strict=True):
            state = clip.reader.open_tile(frame, entry.tile)
            assert len(state) == tile.splats
            kinds.add(state.kind if not isinstance(state, UpdateState) else TileKind.UPDATE)
            if isinstance(state, MotionTile):
                assert entry.looks == state.looks
    assert kinds == set(TileKind)


def test_codebooks_may_begin_with_base_layers() -> None:
    whole = SvqTileCodec(manifest(), books().to_bytes())
    begun = SvqTileCodec(manifest(), whole.base_codebooks())
    assert len(whole.base_codebooks()) < len(books().to_bytes())
    payloads, changes = looks([0, 1, 4], 5.0).payloads, recoloured([0, 1], 6).payloads
    tiles = [[codec.open_tile(of[0]) for of in (payloads, changes)] for codec in (whole, begun)]

    def values(tile: object) -> list[np.ndarray]:
        if isinstance(tile, UpdateState):
            return [array for change in tile.values().values() for array in (change.ids, change.values)]
        assert isinstance(tile, TileState)
        return [array for _, array in tile.dequantise().arrays()]

    def assert_same() -> None:
        for mine, other in zip(*tiles, strict=True):
            for a, b in zip(values(mine), values(other), strict=True):
                np.testing.assert_array_equal(a, b)

    assert_same()
    for tile, of in zip(tiles[1], (payloads, changes), strict=True):
        lod = next(lod for lod in range(1, len(of)) if of[lod])
        with pytest.raises(DecodeError, match="came before its codebook"):
            tile.add_layer(lod, of[lod])  # type: ignore[union-attr]
    begun.extend(books().to_bytes())
    for pair in tiles:
        for tile, of in zip(pair, (payloads, changes), strict=True):
            for lod in range(1, len(of)):
                tile.add_layer(lod, of[lod])  # type: ignore[union-attr]
    assert_same()
    assert begun.base_codebooks() == whole.base_codebooks()
    begun.extend(books().to_bytes())  # a second time changes nothing


def test_codebooks_of_another_encoding_do_not_go_on() -> None:
    begun = SvqTileCodec(manifest(), SvqTileCodec(manifest(), books().to_bytes()).base_codebooks())
    table = books()["scale"].tables[0] + np.float32(1)
    other = {book.attribute: book for book in books()}
    other["scale"] = replace(books()["scale"], tables=(table, *books()["scale"].tables[1:]))
    with pytest.raises(DecodeError, match="do not go on with those that came before"):
        begun.extend(CodebookSet(other).to_bytes())
    with pytest.raises(BundleError, match="LoD order has"):
        begun.extend(begun.base_codebooks())


@pytest.mark.parametrize("data", [books().to_bytes(), books().base.to_bytes()])
def test_a_manifest_of_another_sh_degree_than_its_codebooks_is_refused(data: bytes) -> None:
    with pytest.raises(BundleError, match=r"^manifest: sh_degree is 2, but the codebooks are of degree 0$"):
        SvqTileCodec(replace(manifest(), sh_degree=2), data)
