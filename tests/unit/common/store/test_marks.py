"""A commit shows what came up to a mark, whatever has come since."""

from __future__ import annotations

import numpy as np
import pytest

from cags_common.bundle.codecs import SvqTileCodec
from cags_common.motion.apply import ABSENT_LOGIT
from cags_common.motion.chunk import LEVELS
from cags_common.store.tile_store import TileStore
from cags_common.tiles.inventory import InventoryEntry
from support.closed_loop import encoded_clip
from support.small_motion import looks, motion, moving, recoloured, update
from support.small_store import base, books, layer, removed, xs


@pytest.fixture
def store() -> TileStore:
    return TileStore(moving(), SvqTileCodec(moving(), books().to_bytes()))


def colours(store: TileStore, frame: int, basis: int | None = None) -> list[float]:
    """Base colours of the first two rows after a commit; -1 where there is no splat."""
    gof, _ = store.commit(frame, basis)
    there = gof.splats.logit_opacities[:2] > ABSENT_LOGIT
    return np.where(there, gof.splats.sh0[:2, 0], -1.0).tolist()


def three_marks(store: TileStore) -> TileStore:
    """Before mark 1 a base, before mark 2 a layer of it, after it an update of the next frame."""
    store.add(0, 0, 0, [base([0, 1], 1, code=1)])
    store.end(0, removed())
    store.mark(1)
    store.add(0, 0, 1, [layer(2, 1)])
    store.mark(2)
    payloads = [memoryview(p) for p in recoloured([1], 6).payloads]
    store.add(1, 0, 0, payloads)
    store.end(1, removed(0))
    store.flush()
    return store


def test_a_commit_shows_what_came_up_to_its_mark_and_nothing_later(store: TileStore) -> None:
    three_marks(store)
    assert colours(store, 0, 1) == [1, 1]
    assert colours(store, 0, 2) == [3, 3]
    assert colours(store, 1, 2) == [3, 3], "neither the update nor the removal of the next frame"
    assert store.commit(1, 2)[1].missed
    assert colours(store, 1, 3) == [-1, 6]
    assert not store.commit(1, 3)[1].missed


def test_marks_may_be_passed_over_and_all_that_came_may_be_shown(store: TileStore) -> None:
    three_marks(store)
    assert colours(store, 1, 3) == [-1, 6]


def test_what_was_shown_stays_though_a_later_commit_asks_for_an_earlier_mark(store: TileStore) -> None:
    three_marks(store)
    assert colours(store, 1) == [-1, 6]
    assert colours(store, 1, 2) == [-1, 6]


def test_a_frame_again_is_shown_by_its_mark_though_more_has_come(store: TileStore) -> None:
    three_marks(store)
    assert colours(store, 1, 2) == [3, 3]
    assert colours(store, 0, 2) == [3, 3]
    store.add(0, 0, 2, [layer(2, 1)])
    store.mark(3)
    assert colours(store, 0, 3) == [3, 3]
    assert store.commit(0, 3)[0].splats.logit_opacities[:2].tolist() == [3, 3]


def test_after_all_has_been_shown_an_earlier_frame_goes_back_to_its_mark(store: TileStore) -> None:
    three_marks(store)
    assert colours(store, 1) == [-1, 6]
    assert colours(store, 0, 2) == [3, 3]
    assert colours(store, 1, 2) == [3, 3]


def test_layers_of_a_replaced_tile_count_in_the_replay_by_their_marks(store: TileStore) -> None:
    store.add(0, 0, 0, [base([0, 1], 1)])
    store.end(0, removed())
    store.add(1, 0, 0, [base([0, 1], 2)])
    store.end(1, removed())
    store.mark(1)
    store.commit(1, 1)
    store.add(0, 0, 1, [layer(2, 1)])
    store.flush()
    assert colours(store, 0, 1) == [1, 1]
    store.mark(2)
    assert colours(store, 0, 2) == [3, 3]


def test_motion_that_was_past_is_replayed_by_the_marks_of_its_levels(store: TileStore) -> None:
    chunk = [memoryview(p) for p in motion((0, 0), 1, [0.0, 1 / 32]).payloads]
    store.add(0, 0, 0, [memoryview(p) for p in looks([0], 5).payloads])
    store.add(0, 1, 0, chunk[:1])
    store.add(2, 0, 0, [memoryview(p) for p in motion((0, 0), 1, [2, 3]).payloads])
    for frame in range(4):
        store.end(frame, removed())
    store.mark(1)
    store.commit(3, 1)
    store.add(0, 1, 1, chunk[1:])
    store.flush()
    assert store.commit(1, 1)[0].splats.means[0, 0] == 5
    assert store.commit(1, 2)[0].splats.means[0, 0] == 5 + 1 / 32


def test_a_later_chunk_of_a_later_mark_does_not_end_an_earlier_one(store: TileStore) -> None:
    store.add(0, 0, 0, [memoryview(p) for p in looks([0], 5).payloads])
    store.add(0, 1, 0, [memoryview(p) for p in motion((0, 0), 1, [0, 1, 2, 3]).payloads])
    for frame in range(4):
        store.end(frame, removed())
    store.mark(1)
    assert store.commit(3, 1)[0].splats.means[0, 0] == 8
    store.add(1, 1, 0, [memoryview(p) for p in motion((0, 0), 1, [10, 11, 12]).payloads])
    store.flush()
    assert store.commit(2, 1)[0].splats.means[0, 0] == 7
    assert store.commit(2, 2)[0].splats.means[0, 0] == 16


def test_marks_rise(store: TileStore) -> None:
    store.mark(3)
    with pytest.raises(ValueError, match="mark 3 came after mark 3: marks rise"):
        store.mark(3)


def test_versions_that_nobody_asks_for_any_more_go(store: TileStore) -> None:
    store.add(0, 0, 0, [base([0, 1], 1)])
    store.end(0, removed())
    store.mark(1)
    store.add(0, 0, 1, [layer(2, 1)])
    store.mark(2)
    store.add(0, 0, 2, [layer(2, 1)])
    store.flush()
    gof, _ = store.commit(0, 1)
    held = gof._tiles._tiles[0, 0]
    assert held is not None and held.versions is not None
    assert len(held.versions) == 3
    store.commit(0, 2)
    assert len(held.versions) == 2
    store.commit(0, 3)
    assert len(held.versions) == 1
    assert not gof._tiles._staged and not gof._tiles._several


# --------------------------------------------------------------------------------------------------- another connection


def test_another_connection_begins_with_contiguous_levels_and_no_ends(store: TileStore) -> None:
    chunk = [memoryview(p) for p in motion((0, 0), 2, [0.0, 1 / 32]).payloads]
    store.add(0, 0, 0, [base([0, 1], 5)])
    store.add(0, 0, 2, [layer(2, 1)])  # without the level below it
    store.add(0, 1, 0, chunk[:1])
    store.add(0, 1, 2, chunk[2:])
    store.add(0, 2, 1, [layer(1, 1)])  # without its base
    store.end(0, removed())
    store.mark(4)
    gof, _ = store.commit(0)
    assert gof.splats.logit_opacities[0] == 3, "a level of another attribute shows without the one below it"
    held = sorted(store.held(), key=lambda tile: tile.tile)
    assert held == [InventoryEntry(0, 0, 1), InventoryEntry(0, 1, 1)]
    store.restarted()
    shown, committed = store.commit(0)
    assert shown is gof and committed.missed, "what is on display stays"
    store.end(0, removed())
    store.mark(5)
    shown, committed = store.commit(0, 5)
    assert committed.fresh and not committed.missed
    assert shown.splats.logit_opacities[0] == 1
    assert sorted(store.held(), key=lambda tile: tile.tile) == held
    store.add(0, 2, 0, [base([2], 7, code=2)])
    assert store.commit(0)[0].splats.sh0[2, 0] == 2, "the layer that waited is forgotten"
    store.add(0, 0, 1, [layer(2, 1), layer(2, 1)])
    store.add(0, 1, 1, chunk[1:])
    gof, _ = store.commit(0)
    assert (gof.splats.sh0[0, 0], gof.splats.logit_opacities[0]) == (3, 3)
    assert InventoryEntry(0, 1, LEVELS) in store.held()


def test_of_what_is_held_an_inventory_may_say_less(store: TileStore) -> None:
    store.add(0, 0, 0, [base([0], 5), layer(1, 1), layer(1, 1)])
    store.add(0, 1, 0, [base([1], 6)])
    store.add(0, 2, 0, [memoryview(p) for p in motion((0, 1), 1, [0, 1]).payloads])
    store.end(1, removed())
    store.commit(1)
    store.restarted([InventoryEntry(0, 0, 2), InventoryEntry(0, 2, 2)])
    assert InventoryEntry(0, 0, 2) in store.held()
    store.end(1, removed())
    gof, _ = store.commit(1)
    assert (gof.splats.sh0[0, 0], gof.splats.logit_opacities[0]) == (3, 1)
    assert xs(store, 1)[:2] == [5, -1], "and what moves what is not held waits for it"
    store.add(0, 1, 0, [base([1], 6)])
    assert xs(store, 1)[:2] == [5, pytest.approx(7, abs=0.1)]


def test_what_a_server_believes_in_that_is_not_held_is_told_of(store: TileStore) -> None:
    """Motion that waited for its looks is forgotten with the connection; the Hello had spoken of what was queued."""
    store.add(0, 0, 0, [base([0], 5)])
    store.add(0, 2, 0, [memoryview(p) for p in motion((0, 1), 1, [0, 1]).payloads])
    store.restarted([InventoryEntry(0, 0, 1), InventoryEntry(0, 2, 2)])
    assert store.take_dropped() == [InventoryEntry(0, 2, 0)]
    assert store.take_dropped() == []


@pytest.mark.parametrize(("said", "bits"), [(None, 1), (2, 3)])
def test_layers_of_a_replaced_tile_go_over_where_the_inventory_says_so(
    store: TileStore, said: int | None, bits: int
) -> None:
    for frame in range(2):
        store.add(frame, 0, 0, [base([0], 5 + frame)])
        store.end(frame, removed())
    store.commit(1)
    store.add(0, 0, 1, [layer(1, 1)])
    assert InventoryEntry(0, 0, 1) in store.held()
    store.restarted(None if said is None else [InventoryEntry(0, 0, said)])
    store.end(0, removed())
    gof, _ = store.commit(0)
    assert (gof.splats.means[0, 0], gof.splats.sh0[0, 0]) == (5, bits)


def test_what_was_given_up_may_come_again_over_another_connection(
    store: TileStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cags_common.store.gof_tiles.MAX_KEPT_SPLATS", 0)
    store.add(0, 0, 0, [base([0], 5)])
    store.add(1, 0, 0, [base([0], 6)])
    store.end(1, removed())
    store.commit(1)
    assert not store.kept
    store.restarted()
    assert store.held() == [InventoryEntry(1, 0, 1)]
    store.add(0, 0, 0, [base([0], 5)])
    store.end(0, removed())
    assert xs(store, 1)[0] == 5


# ------------------------------------------------------------------------------------ whatever was committed in between


@pytest.mark.parametrize("first", [0, 1])
def test_of_two_tiles_of_a_frame_the_first_has_a_splat_though_it_comes_after_the_other_was_shown(
    store: TileStore, first: int
) -> None:
    store.end(0, removed())
    for tile in (first, 1 - first):
        store.add(0, tile, 0, [base([0], 1 + tile)])
        store.commit(0)
    assert xs(store, 0)[0] == 1


@pytest.mark.parametrize("late", [False, True])
def test_an_update_of_a_splat_that_comes_again_holds_though_its_removal_comes_late(
    store: TileStore, late: bool
) -> None:
    store.add(0, 0, 0, [base([0], 1)])
    changed = recoloured([0], 6)
    faded = update([0], {"opacity": np.ones(1, bool)}, {"opacity": np.array([7])})
    store.add(3, 0, 0, [memoryview(p) for p in changed.payloads])
    store.add(3, 1, 0, [memoryview(p) for p in faded.payloads])
    if not late:
        store.end(1, removed(0))
    store.end(3, removed())
    if late:
        store.commit(3)
        store.end(1, removed(0))
        store.commit(3)
    store.add(2, 0, 0, [base([0], 2)])
    gof, _ = store.commit(3)
    assert (gof.splats.means[0, 0], gof.splats.sh0[0, 0], gof.splats.logit_opacities[0]) == (2, 6, 7)


def test_a_group_whose_next_is_late_is_shown_at_its_last_frame_whatever_was_shown_of_it(store: TileStore) -> None:
    store.add(0, 0, 0, [memoryview(p) for p in looks([0], 5).payloads])
    store.add(0, 1, 0, [memoryview(p) for p in motion((0, 0), 1, [0, 1, 2, 3]).payloads])
    for frame in range(4):
        store.end(frame, removed())
    assert xs(store, 0)[0] == 5
    gof, committed = store.commit(4)
    assert gof.splats.means[0, 0] == 8
    assert committed.missed and committed.moved.tolist() == [0]


def test_a_group_of_which_only_motion_has_come_has_not_begun(store: TileStore) -> None:
    store.add(0, 0, 0, [base([0], 5)])
    store.end(0, removed())
    store.commit(0)
    store.add(4, 1, 0, [memoryview(p) for p in motion((4, 0), 1, [0, 1]).payloads])
    store.end(4, removed())
    assert xs(store, 4)[0] == 5
    assert not store.commit(4)[1].fresh


def test_of_whole_tiles_a_better_one_that_came_late_does_not_go_over_to_another_connection() -> None:
    """Nothing of it could be taken back: the client once showed a better tile than the inventory said."""
    reader = encoded_clip("video")
    payload = [memoryview(reader.payload(0, 0, quality)) for quality in (0, 1)]
    store, ids = TileStore(reader.manifest, reader.codec), reader.tile_ids(0, 0)
    store.add(0, 0, 0, payload[:1])
    store.end(0, removed())
    store.end(1, ids)
    store.commit(1)
    store.add(0, 0, 1, payload[1:])
    assert store.held() == [InventoryEntry(0, 0, 1)]
    store.restarted()
    store.end(0, removed())
    gof, _ = store.commit(0)
    assert np.array_equal(gof.splats.sh0[ids], reader.codec.open_tile(payload[0]).dequantise().sh0)  # type: ignore[union-attr]
