"""What a client still shows where it was is brought up to date when the viewer turns there."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_common.geometry import Camera, Pose
from cags_common.tiles.kinds import TileKind
from cags_protocol.wire.messages import TileLayers
from cags_server.scene.library import SceneLibrary
from cags_server.scene.visible_tiles import VisibleTile
from cags_server.visibility.ghosts import GHOST_SHARE, ShownLooks, ghosts, merged, shown_bounds
from cags_server.visibility.inventory import ClientInventory
from support.moving_bundle import GROUP, moving_library
from support.server_scene import hello

AHEAD = Camera(hello().intrinsics, Pose.identity(), 0.05)
BEHIND = Camera(hello().intrinsics, Pose.looking_at((0, 0, 0), (0, 0, -3), (0, -1, 0)), 0.05)
LAST = GROUP - 2


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SceneLibrary:
    return moving_library(str(Path(tmp_path_factory.mktemp("moving")) / "bundle"), 5)


def holding(*keys: tuple[int, int]) -> ClientInventory:
    inventory = ClientInventory()
    for frame, tile in keys:
        inventory.delivered(TileLayers(frame, tile, 0, 1, (1,), (0,)))
    return inventory


def key_looks(scene: SceneLibrary) -> list[tuple[int, int]]:
    return [(0, tile.tile) for tile in scene.entry(0).tiles if tile.kind == TileKind.LOOKS]


def shown(scene: SceneLibrary, keys: list[tuple[int, int]]) -> ShownLooks:
    return ShownLooks.of(shown_ids(scene, keys), scene.owners(LAST))


def shown_ids(scene: SceneLibrary, keys: list[tuple[int, int]]) -> np.ndarray:
    out = np.full(scene.manifest.capacity[0], -1, np.int32)
    for key in keys:
        out[scene.tile_ids(*key)] = scene.tile_map(0).number(*key)
    return out


@given(st.lists(st.tuples(st.integers(-1, 5), st.integers(-1, 5)), max_size=40))
def test_what_is_shown_is_counted_by_pairs_of_its_tile_and_the_one_that_replaces_it(
    splats: list[tuple[int, int]],
) -> None:
    found = ShownLooks.of(*np.array(splats, np.int32).reshape(-1, 2).T)
    late = Counter((old, new) for old, new in splats if old != new and old >= 0 and new >= 0)
    pairs = zip(found.older.tolist(), found.newer.tolist(), found.sizes.tolist(), strict=True)
    assert list(pairs) == [(*pair, late[pair]) for pair in sorted(late)]
    there = Counter(old for old, _ in splats if old >= 0)
    assert dict(zip(found.there.tolist(), found.counts.tolist(), strict=True)) == there


def test_newer_motion_of_what_is_shown_in_view_counts_as_visible(scene: SceneLibrary) -> None:
    keys, tiles = key_looks(scene), scene.tile_map(0)
    found = ghosts(scene, LAST, AHEAD, shown(scene, keys), holding(*keys))
    moved = {tile.looks for tile in found if tile.kind == TileKind.MOTION}
    newest = tiles.chunk_at(np.array([tiles.number(*key) for key in keys], np.int32), LAST)
    assert moved == {key for key, chunk in zip(keys, newest.tolist(), strict=True) if chunk >= 0}
    assert moved
    held = holding(*keys, *(tiles.key(int(n)) for n in newest if n >= 0))
    assert not [t for t in ghosts(scene, LAST, AHEAD, shown(scene, keys), held) if t.kind == TileKind.MOTION]


def test_what_is_shown_out_of_view_waits(scene: SceneLibrary) -> None:
    keys = key_looks(scene)
    assert ghosts(scene, LAST, BEHIND, shown(scene, keys), holding(*keys)) == []


def test_a_client_that_shows_nothing_has_no_ghosts(scene: SceneLibrary) -> None:
    assert ghosts(scene, LAST, AHEAD, shown(scene, []), holding()) == []


def test_newer_looks_of_what_is_shown_in_view_count_as_visible(scene: SceneLibrary) -> None:
    keys, owners = key_looks(scene), scene.owners(LAST)
    before = shown_ids(scene, keys)
    replaced = {scene.tile_of(0, int(n)) for n in np.unique(owners[(before >= 0) & (owners >= 0) & (owners != before)])}
    found = ghosts(scene, LAST, AHEAD, shown(scene, keys), holding(*keys))
    assert {(tile.frame, tile.tile) for tile in found if tile.kind == TileKind.LOOKS} == replaced


def test_bounds_are_those_of_the_newest_motion_that_the_client_has(scene: SceneLibrary) -> None:
    tiles = scene.tile_map(0)
    looks = next(int(n) for n in tiles.looks if n >= 0)
    chunks = tiles.chunks_until(looks, LAST)
    assert np.array_equal(shown_bounds(tiles, looks, LAST, holding()), tiles.bounds[looks])
    assert np.array_equal(shown_bounds(tiles, looks, LAST, holding(tiles.key(chunks[-1]))), tiles.bounds[chunks[-1]])


def test_a_ghost_weighs_a_share_of_a_splat_that_is_seen_and_nothing_twice() -> None:
    seen = VisibleTile(0, 0, 10, 50.0, 5.0)
    ghost = VisibleTile(3, 1, 4, 4.0, 2.0, TileKind.MOTION, (0, 0))
    both = merged((seen,), (ghost, cast(VisibleTile, seen)))
    assert [(tile.frame, tile.tile) for tile in both] == [(0, 0), (3, 1)]
    assert both[1].weight == pytest.approx(GHOST_SHARE * 5.0 * 4)
    assert merged((), (ghost,))[0].weight == pytest.approx(GHOST_SHARE * 4)
