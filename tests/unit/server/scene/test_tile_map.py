"""Tiles by number, and the motion that a tile of looks follows."""

from __future__ import annotations

import numpy as np
import pytest

from cags_common.bundle import FrameEntry, TileEntry
from cags_common.errors import BundleError
from cags_common.tiles.kinds import TileKind
from cags_server.scene.tile_map import TileMap

BOX = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)


def looks(tile: int) -> TileEntry:
    return TileEntry(tile, 4, None, BOX, (10,), (0,))


def motion(tile: int, of: tuple[int, int], span: int = 2) -> TileEntry:
    return TileEntry(tile, 4, None, BOX, (10, 5), (0, 0), TileKind.MOTION, of, span)


def frames(*tiles: list[TileEntry], first: int = 10) -> list[FrameEntry]:
    return [FrameEntry(first + at, at == 0, 1, tuple(each), 0, 0, 0, 0) for at, each in enumerate(tiles)]


TWO = frames([looks(0), looks(1), motion(2, (10, 0))], [], [motion(0, (10, 0)), motion(1, (10, 1))], [looks(0)])
"""Looks are numbers 0, 1 and 5; motion of 0 begins in frames 10 and 12, that of 1 in frame 12."""


def test_numbers_and_keys_are_two_names_of_a_tile() -> None:
    tiles = TileMap(TWO)
    assert [tiles.key(n) for n in range(len(tiles))] == [(10, 0), (10, 1), (10, 2), (12, 0), (12, 1), (13, 0)]
    assert [tiles.number(*tiles.key(n)) for n in range(6)] == list(range(6))
    assert tiles.has((13, 0)) and not tiles.has((13, 1)) and not tiles.has((11, 0)) and not tiles.has((9, 0))
    assert not tiles.has((14, 0))


@pytest.mark.parametrize(("frame", "now", "then"), [(10, [2, -1, -1], [3, 4, -1]), (12, [3, 4, -1], [-1, -1, -1])])
def test_a_tile_follows_the_newest_motion_that_has_begun(frame: int, now: list[int], then: list[int]) -> None:
    tiles, of = TileMap(TWO), np.array([0, 1, 5], np.int32)
    assert tiles.chunk_at(of, frame).tolist() == now
    assert tiles.chunk_after(of, frame).tolist() == then
    assert tiles.chunks_until(0, frame) == ([2] if frame < 12 else [3, 2])


def test_new_splats_are_those_of_looks_of_later_frames() -> None:
    tiles = TileMap(TWO)
    assert [tiles.new_splats(10, later) for later in range(10, 14)] == [0, 0, 0, 4]
    assert tiles.new_splats(13, 13) == 0


def test_motion_of_looks_that_are_not_there_is_refused() -> None:
    for of in ((10, 7), (9, 0), (11, 0)):
        with pytest.raises(BundleError, match="frame 10, tile 1"):
            TileMap(frames([looks(0), motion(1, of)], [looks(0)]))


def test_a_group_without_motion_has_none() -> None:
    tiles = TileMap(frames([looks(0)], []))
    assert tiles.chunk_at(np.array([0], np.int32), 11).tolist() == [-1]
    assert tiles.chunks_until(0, 11) == []
    assert not tiles.has_updates
