"""What the client makes of tiles of motion and of updates, one rule a test."""

from __future__ import annotations

import numpy as np
import pytest

from cags_common.bundle import TilePayloads
from cags_common.bundle.codecs import MotionTile, SvqTileCodec
from cags_common.errors import DecodeError
from cags_common.motion.apply import ABSENT_LOGIT
from cags_common.motion.chunk import DEADZONES, LEVELS, Chunk, encode
from cags_common.store.motions import StoredMotion, to_stage
from cags_common.store.tile_decode import Arrival
from cags_common.store.tile_store import TileStore
from cags_common.store.versions import Versions
from cags_common.tiles.inventory import InventoryEntry
from cags_common.tiles.kinds import TileKind
from cags_common.tiles.splat_buffer import Slot, SplatBuffer
from support.anchors import together
from support.small_motion import BOX, looks, motion, moving, recoloured, update
from support.small_store import books, manifest, removed, xs

LAST = 3
"""Last frame of the first group of the small clip."""


@pytest.fixture
def store() -> TileStore:
    return made()


def made(frames: int = 8, starts: tuple[int, ...] = (0, 4)) -> TileStore:
    of = moving(manifest(frames, starts))
    return TileStore(of, SvqTileCodec(of, books().to_bytes()))


def send(store: TileStore, frame: int, tile: int, of: TilePayloads, levels: slice = slice(None)) -> None:
    payloads = [memoryview(payload) for payload in of.payloads]
    first = range(len(payloads))[levels]
    store.add(frame, tile, first.start, payloads[levels])


def end_all(store: TileStore, *frames: int) -> None:
    for frame in frames or range(LAST + 1):
        store.end(frame, removed())


def test_splats_follow_their_motion_and_stay_at_its_end(store: TileStore) -> None:
    send(store, 0, 0, looks([0, 1], 5))
    send(store, 0, 1, motion((0, 0), 2, [0, 1, 3]))
    end_all(store)
    assert [xs(store, frame)[0] for frame in range(LAST + 1)] == [5, 6, 8, 8]
    _, committed = store.commit(LAST)
    assert not committed.changed, "what stands still is not told of again"


def test_only_what_moved_is_told_of_and_apart_from_what_is_new(store: TileStore) -> None:
    send(store, 0, 0, looks([0, 1], 5))
    send(store, 0, 1, motion((0, 0), 2, [0, 1, 2, 3]))
    end_all(store)
    store.commit(0)
    send(store, 1, 0, looks([1], 9))
    _, committed = store.commit(1)
    assert (committed.rows.tolist(), committed.moved.tolist()) == ([1], [0])


def test_what_changed_is_told_of_with_the_frame_in_which_that_begins(store: TileStore) -> None:
    whole = looks([0, 1, 2], 5)
    send(store, 0, 0, whole, slice(0, 1))
    send(store, 1, 0, recoloured([1], 6))
    store.end(0, removed())
    store.end(1, removed())
    store.end(2, removed(2))
    store.commit(0)
    send(store, 0, 0, whole, slice(1, 3))
    _, committed = store.commit(2)
    told = dict(zip(committed.rows.tolist(), committed.began.tolist(), strict=True))
    assert told == {0: 0, 1: 1, 2: 2}, "refined, recoloured, ended"
    assert store.commit(1)[1].began.max() == 1, "going back shows what had begun by then"


def some_moving(store: TileStore) -> None:
    """A tile of two splats of which the second moves."""
    moves = np.zeros((4, 2, 3))
    moves[:, 1, 0] = [0, 64, 128, 192]
    payloads = encode((0, 0), together(2), moves, None, starts=True)
    send(store, 0, 0, looks([0, 1], 5))
    send(store, 0, 1, TilePayloads(2, None, BOX, payloads, TileKind.MOTION, (0, 0), 3))


def test_splats_that_stand_in_a_tile_that_moves_are_told_of_once(store: TileStore) -> None:
    some_moving(store)
    end_all(store)
    store.commit(0)
    told = [store.commit(frame)[1] for frame in range(1, LAST + 1)]
    assert [(c.rows.tolist(), c.moved.tolist()) for c in told] == [([], [1])] * LAST
    between = store.move(LAST, -0.5)
    assert between is not None and between[1].moved.tolist() == [1]


def test_a_splat_of_another_colour_moves_none_and_one_of_another_opacity_is_shown_where_it_is(store: TileStore) -> None:
    some_moving(store)
    send(store, 1, 0, recoloured([1], 7))
    changed = {"opacity": np.ones(1, bool)}
    send(store, 2, 0, update([0], changed, {"opacity": np.array([6])}))
    end_all(store)
    opacities = []
    for frame in range(LAST + 1):
        shown, committed = store.commit(frame)
        opacities.append(shown.splats.logit_opacities[0])
        if frame == 1:
            assert (committed.rows.tolist(), committed.moved.tolist()) == ([1], [])
            assert shown.splats.means[1, 0] > shown.splats.means[0, 0], "it has moved on nevertheless"
    assert opacities[0] == opacities[1] != opacities[2] == opacities[3]


def test_a_splat_that_has_ended_does_not_come_back_by_another_opacity(store: TileStore) -> None:
    send(store, 0, 0, looks([0, 1], 5))
    send(store, 0, 1, motion((0, 0), 2, [0, 0], lives=[1, 2]))
    send(store, 3, 0, update([0, 1], {"opacity": np.ones(2, bool)}, {"opacity": np.array([6, 6])}))
    end_all(store)
    opacities = [store.commit(frame)[0].splats.logit_opacities[:2].copy() for frame in range(LAST + 1)]
    assert all(shown[0] == ABSENT_LOGIT for shown in opacities[1:])
    assert opacities[0][1] == opacities[2][1] != opacities[3][1]


def test_lives_end_without_a_message_and_a_newer_chunk_says_when(store: TileStore) -> None:
    send(store, 0, 0, looks([0, 1], 5))
    send(store, 0, 1, motion((0, 0), 2, [0, 0, 0, 0], lives=[2, 4]))
    end_all(store)
    alive = [[x >= 0 for x in xs(store, frame)[:2]] for frame in range(LAST + 1)]
    assert alive == [[True, True], [True, True], [False, True], [False, True]]


@pytest.mark.parametrize("early", [True, False])
def test_motion_may_come_before_its_looks_and_its_finer_level_before_the_coarse_one(
    store: TileStore, early: bool
) -> None:
    chunk = motion((0, 0), 2, [0, 1, 3])
    send(store, 0, 1, chunk, slice(1, None))
    if early:
        send(store, 0, 1, chunk, slice(0, 1))
        send(store, 0, 0, looks([0, 1], 5))
    else:
        send(store, 0, 0, looks([0, 1], 5))
        send(store, 0, 1, chunk, slice(0, 1))
    end_all(store)
    assert [xs(store, frame)[0] for frame in range(3)] == [5, 6, 8]
    assert InventoryEntry(0, 1, LEVELS) in store.held()


def test_a_finer_level_that_comes_late_changes_the_place_at_once() -> None:
    store, chunk = made(), motion((0, 0), 1, [0.0, 1 / 32, 1 / 16])  # of one and two finest units
    send(store, 0, 0, looks([0], 5))
    send(store, 0, 1, chunk, slice(0, 1))
    end_all(store)
    coarse = xs(store, 2)[0]
    assert not store.commit(2)[0].full
    send(store, 0, 1, chunk, slice(1, None))
    gof, committed = store.commit(2)
    assert committed.moved.tolist() == [0]
    assert abs(gof.splats.means[0, 0] - 5.0625) < abs(coarse - 5.0625)
    assert gof.full


def test_layers_of_looks_that_come_while_they_move_leave_them_where_they_are(store: TileStore) -> None:
    whole = looks([0, 1], 5)
    send(store, 0, 0, whole, slice(0, 1))
    send(store, 0, 1, motion((0, 0), 2, [0, 1, 3]))
    end_all(store)
    assert xs(store, 1)[:2] == [6, 6]
    send(store, 0, 0, whole, slice(1, 3))
    gof, committed = store.commit(1)
    assert committed.rows.tolist() == [0, 1]
    assert gof.splats.means[:2, 0].tolist() == [6, 6]
    assert gof.full


def test_an_update_changes_its_attributes_alone_and_wins_over_later_layers_of_older_looks(store: TileStore) -> None:
    whole = looks([0, 1], 5)
    send(store, 0, 0, whole, slice(0, 1))
    send(store, 1, 0, recoloured([1], 6))
    end_all(store)
    store.commit(0)
    gof, committed = store.commit(1)
    assert committed.rows.tolist() == [1]
    assert gof.splats.sh0[:2, 0].tolist() == [1, 6]
    send(store, 0, 0, whole, slice(1, 3))
    assert store.commit(1)[0].splats.sh0[:2, 0].tolist() == [3, 6]
    assert gof.splats.logit_opacities[:2].tolist() == [3, 3]


def test_an_update_below_its_highest_level_is_not_full_until_newer_looks_take_its_splats(store: TileStore) -> None:
    send(store, 0, 0, looks([0, 1], 5))
    send(store, 1, 0, recoloured([1], 6), slice(0, 1))
    send(store, 2, 0, looks([1], 7))
    end_all(store)
    assert [store.commit(frame)[0].full for frame in range(3)] == [True, False, True]


def test_a_tile_whose_splats_have_all_ended_keeps_nothing_from_being_full(store: TileStore) -> None:
    send(store, 0, 0, looks([0], 5), slice(0, 1))
    send(store, 0, 1, looks([1], 5))
    send(store, 0, 2, motion((0, 0), 1, [0, 0, 0], lives=[2]))
    end_all(store)
    assert [store.commit(frame)[0].full for frame in range(3)] == [False, False, True]


# ----------------------------------------------------------------------------------------------------- what is refused


@pytest.mark.parametrize("late", [False, True])
def test_motion_of_another_number_of_splats_is_refused_in_one_line(store: TileStore, late: bool) -> None:
    wrong, right = motion((0, 0), 3, [0, 7]), motion((0, 0), 2, [0, 1])
    if late:
        send(store, 0, 5, wrong)
    send(store, 0, 0, looks([0, 1], 5))
    message = "motion: 3 splats move, and the looks have 2"
    if late:
        assert [str(error) for error in store.flush()] == [message]
    else:
        with pytest.raises(DecodeError, match=f"^{message}$"):
            send(store, 0, 5, wrong)
    send(store, 0, 6, right)
    end_all(store)
    assert xs(store, 1)[:2] == [6, 6], "what was held stays, and another may come"
    assert InventoryEntry(0, 5, LEVELS) not in store.held()


def test_motion_of_no_looks_of_later_looks_and_of_another_group_is_refused(store: TileStore) -> None:
    send(store, 0, 0, looks([0], 5))
    send(store, 0, 1, motion((0, 0), 1, [0, 1]))
    with pytest.raises(DecodeError, match="tile 2 of frame 1: moves tile 1 of frame 0, which holds no splats"):
        send(store, 1, 2, motion((0, 1), 1, [0, 1]))
    with pytest.raises(DecodeError, match="tile 3 of frame 1: moves tile 0 of frame 2, which is not of its group"):
        send(store, 1, 3, motion((2, 0), 1, [0, 1]))
    with pytest.raises(DecodeError, match="tile 0 of frame 5: moves tile 0 of frame 0, which is not of its group"):
        send(store, 5, 0, motion((0, 0), 1, [0, 1]))


def test_motion_in_a_bundle_that_has_none_is_refused() -> None:
    store = TileStore(manifest(), SvqTileCodec(manifest(), books().to_bytes()))
    send(store, 0, 0, looks([0], 5))
    with pytest.raises(DecodeError, match=r"^motion: cannot be read without the looks that it moves$"):
        send(store, 0, 1, motion((0, 0), 1, [0, 1]))


def test_damaged_motion_is_refused_and_the_motion_that_was_held_goes_on(store: TileStore) -> None:
    good, finer = motion((0, 0), 1, [0, 1]), motion((0, 0), 1, [0, 1])
    send(store, 0, 0, looks([0], 5))
    send(store, 0, 1, good, slice(0, 1))
    for bad in (finer.payloads[1][:3], finer.payloads[1] + b"x"):
        with pytest.raises(DecodeError):
            store.add(0, 1, 1, [memoryview(bad)])
    with pytest.raises(DecodeError):
        store.add(0, 2, 0, [memoryview(good.payloads[0][:-1])])
    end_all(store)
    assert xs(store, 1)[0] == pytest.approx(6, abs=0.1)
    assert InventoryEntry(0, 1, 1) in store.held()


def test_a_damaged_level_that_had_to_wait_is_not_taken_for_held(store: TileStore) -> None:
    chunk = motion((0, 0), 1, [0.0, 1 / 32])
    send(store, 0, 0, looks([0], 5))
    send(store, 0, 1, chunk, slice(0, 1))
    store.add(0, 1, 2, [memoryview(chunk.payloads[2] + b"x")])
    with pytest.raises(DecodeError):
        send(store, 0, 1, chunk, slice(1, 2))
    assert InventoryEntry(0, 1, 1) in store.held() or InventoryEntry(0, 1, 2) in store.held()
    send(store, 2, 0, motion((0, 0), 1, [2, 3]))
    end_all(store)
    store.commit(LAST)
    send(store, 0, 1, chunk, slice(1, 3))
    assert xs(store, 1)[0] == 5 + 1 / 32


def test_motion_that_waited_is_taken_though_it_comes_again_damaged_together_with_its_looks(store: TileStore) -> None:
    """A batch opens its tiles together: not the damaged one in the good one's place."""
    good = motion((0, 0), 1, [2, 3])
    send(store, 0, 1, good)
    begun, damaged = looks([0], 5).payloads[0], memoryview(good.payloads[0][:-1])
    errors = store.add_all([Arrival(0, 0, 0, [memoryview(begun)]), Arrival(0, 1, 0, [damaged])])
    errors += store.flush()
    end_all(store)
    assert errors == []
    assert xs(store, 1)[0] == 8


def test_motion_whose_looks_never_come_waits_within_bounds(store: TileStore, monkeypatch: pytest.MonkeyPatch) -> None:
    chunk = motion((0, 9999), 2, [0, 1])
    monkeypatch.setattr("cags_common.store.reorder_buffer.MAX_WAITING_BYTES", 10 * len(chunk.payloads[0]))
    for tile in range(1000):
        send(store, 0, tile, chunk, slice(0, 1))
    dropped = store.take_dropped()
    assert dropped == [InventoryEntry(0, tile, 0) for tile in range(990)]
    tiles = store.commit(0)[0]._tiles
    assert tiles._waiting.bytes <= 10 * len(chunk.payloads[0])
    assert len(tiles._motions._looks_of) == 10
    send(store, 0, 9999, looks([0, 1], 5))
    end_all(store)
    assert xs(store, 1)[:2] == [6, 6]
    assert not tiles._motions._looks_of


# ------------------------------------------------------------------------------------- loops, jumps, what is kept of it


def walk(store: TileStore) -> None:
    """Two chunks one after the other, and an update in between."""
    send(store, 0, 0, looks([0], 5))
    send(store, 0, 1, motion((0, 0), 1, [0, 1]))
    send(store, 1, 0, recoloured([0], 6))
    send(store, 2, 0, motion((0, 0), 1, [2, 3]))
    end_all(store)
    for frame in range(LAST + 1):
        store.commit(frame)


def test_loops_and_jumps_show_what_was_shown_and_ask_for_nothing(store: TileStore) -> None:
    walk(store)
    for frame in (0, 1, 2, 3, 1, 3, 0, 2):
        assert store.holds(frame)
        assert xs(store, frame)[0] == [5, 6, 7, 8][frame]
        assert store.on_display is not None
        assert store.on_display.splats.sh0[0, 0] == (3 if frame == 0 else 6)


def test_a_chunk_that_is_past_is_kept_as_its_payloads_and_decoded_only_where_it_counts(store: TileStore) -> None:
    walk(store)
    gof = store.commit(LAST)[0]
    first, second = (gof._tiles._tiles[key] for key in ((0, 1), (2, 0)))
    assert isinstance(first, StoredMotion) and isinstance(second, StoredMotion)
    assert first.versions is None
    assert second.versions is not None
    assert InventoryEntry(0, 1, LEVELS) in store.held()
    store.commit(0)
    assert first.versions is not None


def test_a_finer_level_of_a_past_chunk_counts_in_the_replay(store: TileStore) -> None:
    chunk = motion((0, 0), 1, [0.0, 1 / 32])
    send(store, 0, 0, looks([0], 5))
    send(store, 0, 1, chunk, slice(0, 1))
    send(store, 2, 0, motion((0, 0), 1, [2, 3]))
    end_all(store)
    assert xs(store, 1)[0] == 5
    store.commit(LAST)
    send(store, 0, 1, chunk, slice(1, None))
    assert xs(store, 1)[0] == 5 + 1 / 32


@pytest.mark.parametrize("least", [1, 0])
def test_what_is_kept_of_motion_and_updates_is_bounded(
    store: TileStore, least: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cags_common.store.gof_tiles.MAX_KEPT_SPLATS", least)
    walk(store)
    assert not store.kept
    assert not store.holds(0)
    send(store, 2, 1, looks([0], 9))
    gof = store.commit(LAST)[0]
    kept = {key for key, held in gof._tiles._tiles.items() if held is not None}
    assert kept == {(2, 1)}, "neither past motion, nor updates of which nothing is left"
    send(store, 0, 1, motion((0, 0), 1, [0, 1]))  # once more, in vain
    assert xs(store, LAST)[0] == 9


def test_what_motion_makes_of_a_group_ends_with_it(store: TileStore) -> None:
    send(store, 0, 0, looks([0], 5))
    send(store, 0, 1, motion((0, 0), 1, [0, 1, 2, 3, 4, 5, 6]))
    send(store, 4, 0, looks([0], 30))
    end_all(store, *range(6))
    assert [xs(store, frame)[0] for frame in range(6)] == [5, 6, 7, 8, 30, 30]


def test_a_lost_chunk_leaves_splats_at_the_end_of_the_one_before_and_the_next_is_right_again() -> None:
    store = made(10, (0,))
    send(store, 0, 0, looks([0], 5))
    send(store, 0, 1, motion((0, 0), 1, [0, 1, 2]))
    send(store, 6, 0, motion((0, 0), 1, [6, 7, 8]))  # that of frame 3 is lost
    end_all(store, *range(10))
    assert [xs(store, frame)[0] for frame in range(10)] == [5, 6, 7, 7, 7, 7, 11, 12, 13, 13]


def test_whoever_joins_in_the_middle_needs_the_looks_and_the_newest_chunk_alone() -> None:
    store = made(10, (0,))
    send(store, 0, 0, looks([0], 5))
    send(store, 6, 0, motion((0, 0), 1, [6, 7, 8]))
    end_all(store, 6)
    assert xs(store, 7)[0] == 12


def test_between_frames_splats_are_on_the_line_and_the_frame_itself_is_shown_again(store: TileStore) -> None:
    send(store, 0, 0, looks([0, 1], 5))
    send(store, 0, 1, motion((0, 0), 2, [0, 1, 3]))
    end_all(store)
    gof, _ = store.commit(1)
    assert gof.move(1.5).tolist() == [0, 1]
    assert gof.splats.means[0, 0] == 7
    assert xs(store, 2)[0] == 8
    assert store.commit(2)[1].moved.tolist() == []


def test_nothing_drifts_over_ten_thousand_frames() -> None:
    """Chunk after chunk, backwards and forwards: always against the looks."""
    frames = 10_000
    store, span = made(frames, (0,)), 50
    send(store, 0, 0, looks([0], 5))
    where = [np.sin(np.arange(first, first + span + 1) * 0.01) * 3 for first in range(0, frames, span)]
    step = 1 / 32
    for at, first in enumerate(range(0, frames, span)):
        send(store, first, 1, motion((0, 0), 1, list(where[at])))
        store.end(first, removed())
    largest = 0.0
    for frame in range(0, frames, 7):
        gof, _ = store.commit(frame)
        largest = max(largest, abs(gof.splats.means[0, 0] - 5 - np.sin(frame * 0.01) * 3))
    assert largest <= (0.51 + DEADZONES[-1]) * step
    at_the_end = gof.splats.means[0].copy()
    alone = made(frames, (0,))
    send(alone, 0, 0, looks([0], 5))
    last = len(where) - 1
    send(alone, last * span, 1, motion((0, 0), 1, list(where[last])))
    alone.end(last * span, removed())
    assert np.array_equal(alone.commit(frame)[0].splats.means[0], at_the_end)
    assert sum(isinstance(h, StoredMotion) and h.versions is not None for h in gof._tiles._tiles.values()) <= 2


def test_many_at_once_in_any_order_are_opened_together() -> None:
    store = TileStore(moving(), SvqTileCodec(moving(), books().to_bytes()), threads=2)
    arrivals = [
        Arrival(0, tile, 0, [memoryview(p) for p in of.payloads])
        for tile, of in ((1, motion((0, 0), 2, [0, 1])), (2, motion((0, 7), 1, [0, 4])), (0, looks([0, 1], 5)))
    ]
    assert store.add_all(arrivals) == []
    send(store, 0, 7, looks([3], 5))
    end_all(store)
    assert xs(store, 1)[:4] == [6, 6, -1, 9]


# ----------------------------------------------------------------------------------------------------------- the buffer


def test_an_update_of_the_opacity_of_splats_that_are_to_come_waits_for_them() -> None:
    """It once made them absent."""
    store = made()
    changed = {"opacity": np.ones(1, bool)}
    from support.small_motion import update

    send(store, 1, 0, update([0], changed, {"opacity": np.array([7])}))
    end_all(store)
    assert xs(store, 1)[0] == -1
    send(store, 0, 0, looks([0], 5))
    gof, _ = store.commit(1)
    assert gof.splats.logit_opacities[0] == 7
    assert gof.splats.logit_opacities[1] == ABSENT_LOGIT


def test_tiles_that_have_ended_or_stand_still_are_not_evaluated_again(monkeypatch: pytest.MonkeyPatch) -> None:
    counted: list[int] = []
    import cags_common.tiles.splat_buffer as module

    move_rows = module.move_rows

    def counting(tiles, *rest):  # type: ignore[no-untyped-def]
        counted.append(len(tiles))
        move_rows(tiles, *rest)

    monkeypatch.setattr(module, "move_rows", counting)
    store = made()
    send(store, 0, 0, looks([0], 5))
    send(store, 0, 1, looks([1], 5))
    send(store, 0, 2, motion((0, 0), 1, [0, 1, 2, 3], lives=[1]))
    send(store, 0, 3, motion((0, 1), 1, [0, 1]))
    end_all(store)
    for frame in range(LAST + 1):
        store.commit(frame)
    assert counted == [2, 2], "both, and once more to end one and bring the other to its end; then none"


def test_what_is_staged_of_a_chunk_does_not_change_while_a_finer_level_is_added() -> None:
    chunk = motion((0, 0), 1, [0.0, 1 / 32])
    versions = Versions(MotionTile(chunk.payloads[0], together(1)), 0)
    held = StoredMotion((0, 1), (0, 0), versions, {})
    (make,) = to_stage(held)
    staged = make()
    assert isinstance(staged.value, Chunk) and staged.value.moves is not None
    for level in range(1, LEVELS):
        versions.writable(0).add_layer(level, chunk.payloads[level])
    assert not staged.value.moves.any()
    assert versions.newest.chunk.moves is not None and versions.newest.chunk.moves.any()


def test_a_buffer_without_motion_moves_nothing() -> None:
    buffer = SplatBuffer(4, 0)
    buffer.add(Slot(0, (0, 0)))
    assert buffer.move(3.5).tolist() == []
    assert buffer.moves((0, 0)) is None
    assert buffer.drop_past(9) == []


def test_a_picture_depends_on_the_motion_and_the_updates_of_what_it_shows(store: TileStore) -> None:
    send(store, 0, 0, looks([0, 1], 5))
    send(store, 0, 1, motion((0, 0), 2, [0, 1, 3]), slice(0, 1))
    send(store, 0, 2, looks([2], 7))
    send(store, 1, 0, recoloured([1], 9))
    end_all(store)
    of, _ = store.commit(1)
    seen = np.zeros(of.capacity, np.float32)
    seen[0] = 1.0
    assert of.visible_lods(seen).keys() == {(0, 0), (0, 1)}, "not what another splat's colour is from"
    assert of.visible_lods(seen)[0, 1] == 1, "of its motion one level is there"
    seen[1] = 1.0
    assert of.visible_lods(seen).keys() == {(0, 0), (0, 1), (1, 0)}


def ramped(ids: list[int], code: int, frames: int) -> TilePayloads:
    """``ids`` reach another base colour in ``frames`` frames."""
    n = len(ids)
    return update(ids, {"sh0": np.ones(n, bool)}, {"sh0": np.full(n, code)}, np.full(n, frames))


def colours(store: TileStore) -> np.ndarray:
    """[LAST + 1, 3] of splat 0 in every frame."""
    return np.stack([store.commit(frame)[0].splats.sh0[0].copy() for frame in range(LAST + 1)])


def test_a_colour_is_on_its_way_for_as_long_as_the_update_says(store: TileStore) -> None:
    send(store, 0, 0, looks([0, 1], 5))
    send(store, 1, 0, ramped([0], 6, 2))
    end_all(store)
    seen = colours(store)
    assert np.array_equal(seen[2], seen[3]) and not np.array_equal(seen[0], seen[3])
    assert np.allclose(seen[1], (seen[0] + seen[3]) / 2)
    assert store.commit(LAST)[1].rows.tolist() == [], "it has arrived"


@pytest.mark.parametrize("late", [(0, 0), (1, 0)])
def test_what_comes_late_shows_as_if_it_had_been_in_time(late: tuple[int, int]) -> None:
    tiles = {(0, 0): looks([0, 1], 5), (1, 0): recoloured([0], 3), (2, 0): ramped([0], 6, 4)}
    wanted, found = made(), made()
    for key, tile in tiles.items():
        send(wanted, *key, tile)
        if key != late:
            send(found, *key, tile)
    end_all(wanted)
    end_all(found)
    for frame in (0, 1, 2):
        found.commit(frame)
    send(found, *late, tiles[late])
    expected = colours(wanted)[LAST]
    assert np.array_equal(found.commit(LAST)[0].splats.sh0[0], expected)
    assert np.array_equal(colours(found)[LAST], expected), "also when it is shown again from the beginning"
