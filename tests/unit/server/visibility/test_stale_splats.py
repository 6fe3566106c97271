"""Splats that moved out of sight are still brought to where they are."""

from __future__ import annotations

import uuid

import numpy as np

from cags_protocol.wire.messages import TileLayers
from cags_server.visibility.ghosts import StaleSplats
from cags_server.visibility.inventory import ClientInventory
from support.moving_bundle import moving_library
from support.server_scene import library

LEAST = 0.02


def seen(*ids: int) -> np.ndarray:
    """Contributions [40] of the scene's splats: 1 for those in view."""
    out = np.zeros(40, np.float32)
    out[list(ids)] = 1.0
    return out


def holding(*keys: tuple[int, int]) -> ClientInventory:
    inventory = ClientInventory()
    for frame, tile in keys:
        inventory.delivered(TileLayers(frame, tile, 0, 1, (1,), (0,)))
    return inventory


KEY_TILES = tuple((0, tile) for tile in range(4))


def test_what_left_the_picture_while_it_changed_counts_until_its_change_is_on_its_way() -> None:
    lingering = StaleSplats(library(), LEAST)
    inventory = holding(*KEY_TILES)
    lingering.update(seen(3, 8), 0, inventory)
    assert not len(lingering), "what is seen is held"
    lingering.update(seen(3, 8), 3, inventory)  # splat 3 changes in frame 3, and that is not held
    assert lingering.added_to(seen(8), 4)[3] == 1.0, "out of sight now, but shown at its old place"
    lingering.update(seen(8), 4, inventory)
    assert lingering.added_to(seen(8), 5)[3] == 1.0, "it lingers on"
    lingering.update(seen(8), 5, holding(*KEY_TILES, (3, 0)))
    assert np.array_equal(lingering.added_to(seen(8), 5), seen(8))


def test_another_group_of_frames_has_other_ids() -> None:
    lingering = StaleSplats(library(), LEAST)
    lingering.update(seen(3), 3, holding(*KEY_TILES))
    assert len(lingering) == 1
    assert np.array_equal(lingering.added_to(seen(8), 6), seen(8))
    lingering.update(seen(8), 6, holding((6, 0)))
    assert not len(lingering)


def test_what_was_never_seen_does_not_linger() -> None:
    lingering = StaleSplats(library(), LEAST)
    lingering.update(seen(8), 3, holding(*KEY_TILES))
    assert not len(lingering)


def test_what_left_the_picture_while_it_moved_counts_until_its_motion_is_on_its_way() -> None:
    scene = moving_library(f"memory://{uuid.uuid4().hex}", 5)
    frame, tiles = 3, scene.tile_map(3)
    owners = scene.owners(frame)
    moving = [n for n in np.unique(owners[owners >= 0]).tolist() if tiles.chunks_until(n, frame)]
    looks, splat = tiles.key(moving[0]), int(np.flatnonzero(owners == moving[0])[0])
    contribution = np.zeros(scene.manifest.capacity[0], np.float32)
    contribution[splat] = 1.0
    lingering = StaleSplats(scene, LEAST)
    lingering.update(contribution, frame, holding(looks))
    assert lingering.added_to(0 * contribution, frame)[splat] == 1.0, "its looks alone show it where it was"
    lingering.update(0 * contribution, frame, holding(looks, tiles.key(tiles.chunks_until(moving[0], frame)[0])))
    assert not len(lingering)


def test_what_lingers_joins_what_is_seen() -> None:
    lingering = StaleSplats(library(), LEAST)
    lingering.update(seen(3, 8), 3, holding(*KEY_TILES))
    for contribution in (seen(8), 0.5 * seen(3, 35), seen()):
        splats = np.flatnonzero(contribution)
        ids, weights = lingering.joined(splats, contribution[splats], 4)
        dense = np.zeros(40, np.float32)
        dense[ids] = weights
        assert np.array_equal(dense, lingering.added_to(contribution, 4))
        assert list(ids) == sorted(set(ids))
