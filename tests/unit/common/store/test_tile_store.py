"""The store's rules, under every order of arrival that a link can make."""

import itertools
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from cags_common.bundle.codecs import SvqTileCodec
from cags_common.errors import DecodeError
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.motion.apply import ABSENT_LOGIT
from cags_common.store.tile_store import TileStore
from cags_common.tiles.inventory import InventoryEntry
from support.small_store import CAPACITY, base, books, layer, manifest, removed, xs


@pytest.fixture
def store() -> TileStore:
    return TileStore(manifest(), SvqTileCodec(manifest(), books().to_bytes()))


def test_a_frame_appears_all_at_once_and_not_before_its_time(store: TileStore) -> None:
    store.add(0, 0, 0, [base([0, 1], 1)])
    assert xs(store, 0)[:2] == [-1, -1]  # its end has not come
    store.end(0, removed())
    store.add(1, 0, 0, [base([1], 2)])
    store.end(1, removed())
    assert xs(store, 0)[:2] == [1, 1]  # frame 1 has come, but is not shown yet
    assert xs(store, 1)[:2] == [1, 2]


def test_the_end_of_a_later_frame_makes_earlier_ones_whole(store: TileStore) -> None:
    store.add(0, 0, 0, [base([0], 1)])
    store.end(2, removed())
    _, committed = store.commit(1)
    assert committed.missed
    assert xs(store, 2)[0] == 1


def test_rows_that_changed_are_reported_and_no_others(store: TileStore) -> None:
    store.add(0, 0, 0, [base([0, 1, 2], 1)])
    store.end(0, removed())
    _, first = store.commit(0)
    assert (first.fresh, first.rows.tolist(), first.missed) == (True, [0, 1, 2], False)
    store.add(1, 0, 0, [base([2], 2)])
    store.end(1, removed(0))
    _, second = store.commit(1)
    assert (second.fresh, second.rows.tolist()) == (False, [0, 2])
    assert store.commit(1)[1].rows.tolist() == []


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_of_two_tiles_of_a_frame_that_claim_one_splat_the_first_has_it(
    store: TileStore, order: tuple[int, int]
) -> None:
    for tile in order:
        store.add(0, tile, 0, [base([0], 1 + tile)])
    store.end(0, removed())
    assert xs(store, 0)[0] == 1


def test_any_order_of_arrival_ends_in_the_same_splats() -> None:
    arrivals = (
        ("add", 0, 0, 0, [base([0, 1, 2, 3], 1)]),
        ("add", 1, 0, 0, [base([1, 2], 2)]),
        ("add", 2, 0, 0, [base([2], 3)]),
        ("end", 1, removed(3)),
        ("end", 2, removed(0)),
        ("add", 0, 0, 1, [layer(4, 1)]),
    )
    for order in itertools.permutations(arrivals):
        store = TileStore(manifest(), SvqTileCodec(manifest(), books().to_bytes()))
        for name, *arguments in order:
            getattr(store, name)(*arguments)
        assert xs(store, 2)[:4] == [-1, 2, 3, -1], [item[:3] for item in order]


@pytest.mark.parametrize("shown_between", [False, True])
def test_a_layer_changes_only_the_splats_that_its_tile_still_owns(store: TileStore, shown_between: bool) -> None:
    store.add(0, 0, 0, [base([0, 1], 1, code=1)])
    store.add(1, 0, 0, [base([1], 2, code=3)])
    store.end(1, removed())
    if shown_between:
        store.commit(1)
    store.add(0, 0, 1, [layer(2, 1)])
    gof, _ = store.commit(1)
    assert gof.splats.sh0[:2, 0].tolist() == [0b11, 3]  # refined; the newer splat's base code stays


def test_layers_may_come_before_their_base_and_twice(store: TileStore) -> None:
    store.add(0, 0, 2, [layer(1, 0)])
    store.add(0, 0, 1, [layer(1, 1)])
    store.add(0, 0, 0, [base([5], 1, code=2)])
    store.add(0, 0, 0, [base([5], 1, code=2), layer(1, 1)])
    store.end(0, removed())
    gof, _ = store.commit(0)
    assert gof.splats.sh0[5, 0] == 0b101
    assert gof.splats.logit_opacities[5] == 0b100
    assert gof.full


def test_a_removed_id_may_be_used_again(store: TileStore) -> None:
    store.add(0, 0, 0, [base([0], 1)])
    store.end(0, removed())
    store.commit(0)
    store.add(1, 0, 0, [base([0], 2)])  # removed and used again in the same frame
    store.end(1, removed(0))
    assert xs(store, 1)[0] == 2
    store.end(2, removed(0))
    assert xs(store, 2)[0] == -1
    store.add(1, 1, 0, [base([0], 9)])  # late: from before the removal
    assert xs(store, 3)[0] == -1


def test_the_next_group_of_frames_replaces_the_ids(store: TileStore) -> None:
    store.add(0, 0, 0, [base([0, 1], 1)])
    store.end(0, removed())
    store.add(4, 0, 0, [base([0], 7)])
    store.end(4, removed())
    assert xs(store, 3)[:2] == [1, 1]
    gof, committed = store.commit(4)
    assert committed.fresh
    assert gof.splats.means[0, 0] == 7
    assert gof.splats.logit_opacities[1] == ABSENT_LOGIT
    store.add(3, 0, 0, [base([1], 5)])  # late, of the group that is over
    assert xs(store, 5)[:2] == [7, -1]


def test_the_old_group_stays_on_display_until_something_of_the_new_one_is_whole(store: TileStore) -> None:
    store.add(0, 0, 0, [base([0], 1)])
    store.end(0, removed())
    store.commit(3)
    gof, committed = store.commit(4)
    assert committed.missed
    assert gof.splats.means[0, 0] == 1
    store.add(4, 0, 0, [base([0], 7)])
    store.end(4, removed())
    gof, committed = store.commit(5)
    assert committed.fresh
    assert gof.splats.means[0, 0] == 7


def two_groups(store: TileStore) -> None:
    """The first with splat 0 at 1, then at 2; the other at 7, then at 8."""
    for frame, value in ((0, 1), (2, 2), (4, 7), (6, 8)):
        store.add(frame, 0, 0, [base([0], value)])
        store.end(frame, removed())


def test_a_clip_that_is_kept_whole_is_shown_again_in_any_order(store: TileStore) -> None:
    two_groups(store)
    for _ in range(3):
        for frame, x in ((0, 1), (2, 2), (4, 7), (6, 8)):
            gof, committed = store.commit(frame)
            assert (gof.splats.means[0, 0], committed.fresh, committed.missed) == (x, frame in (0, 4), False)
    assert store.kept == range(8)
    for frame, x in ((3, 2), (6, 8), (0, 1), (5, 7)):
        assert xs(store, frame)[0] == x
    assert store.reaches(0) and store.holds(6)


def test_what_comes_for_a_group_that_rests_is_shown_with_it(store: TileStore) -> None:
    two_groups(store)
    store.commit(0)
    store.commit(4)
    resting = store.nbytes
    store.add(0, 0, 1, [layer(1, 1)])
    store.add(2, 1, 0, [base([1], 3)])
    assert store.nbytes == resting
    gof, _ = store.commit(2)
    assert gof.splats.means[:2, 0].tolist() == [2, 3]
    assert gof.shown.tiles[0].key == (0, 0)
    assert xs(store, 6)[:2] == [8, -1]


def test_a_group_that_rests_takes_no_memory_for_its_splats(store: TileStore) -> None:
    two_groups(store)
    store.commit(0)
    one = store.nbytes
    for frame in (4, 0, 6, 2):
        store.commit(frame)
        assert store.nbytes == one


def test_before_the_first_group_of_a_clip_that_is_kept_whole_the_last_one_is_shown(store: TileStore) -> None:
    """A play that began in the second group comes to the first one in a loop, before anything of it is there."""
    store.add(4, 0, 0, [base([0], 7)])
    store.end(4, removed())
    store.add(6, 0, 0, [base([0], 8)])
    store.end(6, removed())
    store.commit(7)
    gof, committed = store.commit(0)
    assert committed.missed and not committed.fresh
    assert gof.splats.means[0, 0] == 8
    store.add(0, 0, 0, [base([0], 1)])
    store.end(0, removed())
    assert xs(store, 0)[0] == 1
    assert xs(store, 4)[0] == 7, "as of that frame, not of the one that stayed on display"


def test_a_large_clip_drops_the_groups_that_are_past(store: TileStore, groups_pass: None) -> None:
    store = TileStore(manifest(), SvqTileCodec(manifest(), books().to_bytes()))
    two_groups(store)
    store.commit(0)
    assert store.kept == range(4)
    store.commit(4)
    assert store.kept == range(4, 8)
    assert not store.reaches(3)
    assert {tile.frame for tile in store.held()} == {4, 6}


def test_a_clip_whose_groups_together_are_too_much_is_kept_no_more(
    store: TileStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cags_common.store.gof_tiles.MAX_KEPT_SPLATS", 1)
    two_groups(store)
    store.commit(2)
    store.commit(6)
    assert store.kept == range(4, 8), "each group alone is within the bound"
    assert {tile.frame for tile in store.held()} == {4, 6}
    store.reset(1)
    assert store.kept == range(8), "from the beginning"


def test_a_clip_that_is_kept_no_more_goes_on_where_nothing_of_the_frame_is_there(
    store: TileStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The last group is shown in place of the first: what stops being kept then is not what comes."""
    store.add(4, 0, 0, [base([0], 7)])
    store.end(4, removed())
    store.add(6, 0, 0, [base([0], 8)])
    store.end(6, removed())
    store.commit(7)
    monkeypatch.setattr("cags_common.store.gof_tiles.MAX_KEPT_SPLATS", 0)
    for frame in (0, 1):
        gof, committed = store.commit(frame)
        assert committed.missed
        assert gof.splats.means[0, 0] == 8
    store.add(0, 0, 0, [base([0], 1)])
    store.end(1, removed())
    assert xs(store, 1)[0] == 1


def test_damage_is_refused_and_what_was_held_stays(store: TileStore) -> None:
    store.add(0, 0, 0, [base([0], 1)])
    store.end(0, removed())
    for bad in (b"", b"\x00" * 10, bytes(base([0], 1))[:-5]):
        with pytest.raises(DecodeError):
            store.add(0, 1, 0, [memoryview(bad)])
    with pytest.raises(DecodeError, match="outside the group's capacity"):
        store.add(0, 2, 0, [base([CAPACITY], 1)])
    with pytest.raises(DecodeError, match="outside the group's capacity"):
        store.end(1, removed(CAPACITY))
    with pytest.raises(DecodeError, match="outside the clip"):
        store.add(99, 0, 0, [base([0], 1)])
    assert xs(store, 0)[0] == 1


def test_layers_that_wait_for_their_base_are_bounded(store: TileStore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cags_common.store.reorder_buffer.MAX_WAITING_BYTES", 100)
    for tile in range(1000):
        store.add(0, tile, 1, [layer(4, 1)])
    gof, _ = store.commit(0)
    assert gof._tiles._waiting.bytes <= 100
    dropped = store.take_dropped()
    kept = 1000 - len(dropped)
    assert kept > 0, "the newest wait on"
    assert dropped == [InventoryEntry(0, tile, 0) for tile in range(1000 - kept)], "the server is told of the others"
    assert store.take_dropped() == [], "once"


def replaced_thrice(store: TileStore) -> TileStore:
    """Frames 0 .. 3, each with the same two splats anew; the third also ends splat 2."""
    store.add(0, 1, 0, [base([2, 3], 9)])
    for frame in range(4):
        store.add(frame, 0, 0, [base([0, 1], frame + 1)])
        store.end(frame, removed(2) if frame == 2 else removed())
        store.commit(frame)
    return store


def test_tiles_without_splats_left_take_no_part(store: TileStore) -> None:
    gof, _ = replaced_thrice(store).commit(3)
    assert sum(held is not None and held.owned > 0 for held in gof._tiles._tiles.values()) == 2
    store.add(0, 0, 1, [layer(2, 1)])  # late, for a replaced one
    assert gof.commit(3).rows.tolist() == []


def test_earlier_frames_are_shown_again_from_what_is_held(store: TileStore) -> None:
    replaced_thrice(store)
    for frame in (0, 1, 2, 3, 1, 3, 0):  # a loop, a jump back, a jump ahead
        assert store.holds(frame)
        assert xs(store, frame)[:4] == [frame + 1, frame + 1, -1 if frame >= 2 else 9, 9]


def test_layers_that_come_after_their_tile_was_replaced_count_in_the_replay(store: TileStore) -> None:
    replaced_thrice(store)
    store.add(0, 0, 1, [layer(2, 1)])
    gof, committed = store.commit(0)
    assert len(committed.rows) == CAPACITY
    assert gof.shown.tiles[0].shown_lod == 1
    assert gof.splats.sh0[0, 0] == 3  # code 1 with another bit


@pytest.mark.parametrize(("bound", "least"), [("MAX_KEPT_SPLATS", 3), ("MAX_LATE_BYTES", 0)])
def test_what_is_kept_for_a_replay_is_bounded(
    store: TileStore, bound: str, least: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(f"cags_common.store.gof_tiles.{bound}", least)
    replaced_thrice(store)
    store.add(0, 0, 1, [layer(2, 1)])
    gof, _ = store.commit(3)
    assert not store.kept
    assert not store.holds(0)
    assert sum(held is not None for held in gof._tiles._tiles.values()) == 2
    assert not gof._tiles._late


def test_lod_mean_counts_what_is_in_view(store: TileStore) -> None:
    store.add(0, 0, 0, [base([0, 1, 2], 5), layer(3, 0), layer(3, 0)])
    store.add(0, 1, 0, [base([3], 60)])
    store.end(0, removed())
    gof, _ = store.commit(0)
    view = Intrinsics.of_fov(40, 30, 0.5, 0.4)
    near = Camera(view, Pose.looking_at((5, 5, 2), (5, 5, 5)))
    both = Camera(view, Pose.looking_at((0, 0, 0.0), (5, 5, 5)))
    away = Camera(view, Pose.looking_at((0, 0, 0.0), (-5, -5, -5)))
    assert gof.shown.lod_mean(near) == 2
    assert gof.shown.lod_mean(both) == pytest.approx(1.5)
    assert np.isnan(gof.shown.lod_mean(away))
    assert not gof.full


def test_a_reset_forgets_and_starts_anywhere(store: TileStore) -> None:
    store.add(4, 0, 0, [base([0], 7)])
    store.end(4, removed())
    store.commit(4)
    store.reset(0)
    store.add(0, 0, 0, [base([0], 1)])
    store.end(0, removed())
    assert xs(store, 0)[0] == 1


def test_what_has_come_whole_ahead_of_the_display_is_told(store: TileStore) -> None:
    assert store.ahead(0) == 0
    for frame in (0, 1, 4):  # of two groups
        store.add(frame, 0, 0, [base([0], 1)])
        store.end(frame, removed())
    store.commit(0)
    assert store.ahead(0) == 4
    assert store.ahead(5) == 0


def test_groups_that_only_arrive_cost_the_memory_of_what_has_come_of_them() -> None:
    rows, groups = 1_000_000, 12
    claimed = replace(manifest(groups, tuple(range(groups))), capacity=(rows,) * groups)
    store = TileStore(claimed, SvqTileCodec(claimed, books().to_bytes()))
    tracemalloc.start()
    try:
        for frame in range(groups):
            store.add(frame, 0, 0, [base([rows - 1], frame)])
            store.end(frame, removed())
        arrived = tracemalloc.get_traced_memory()[1]
        shown, _ = store.commit(0)
        assert shown.splats.means[rows - 1, 0] == 0
        taken = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert arrived < 1_000_000, "bytes, with a tile of each group"
    assert taken > 50 * rows, "of the group on display, whose every row may be drawn"
