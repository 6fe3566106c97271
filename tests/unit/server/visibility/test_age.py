"""What a client is shown an old version of, and for how long."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_common.tiles.kinds import TileKind
from cags_server.scene.library import SceneLibrary
from cags_server.visibility.age import VersionAge
from support.moving_bundle import GROUP as MOVING_FRAMES
from support.moving_bundle import moving_library
from support.server_scene import library

GROUP = range(6)
"""Frames of the scene's first group; splats change in some of them."""

TILES = [(frame, tile.tile) for frame in GROUP for tile in library().entry(frame).tiles]
"""(media frame, tile)."""

CHANGED = next(key for key in TILES if key[0] > 0)


def test_the_next_version_of_what_is_held_replaces_one_frame() -> None:
    age = VersionAge(library())
    for key in TILES:
        if key[0] == 0:
            age.sent(*key)
    assert age.frames(CHANGED[0], *CHANGED) == CHANGED[0]
    age.sent(*CHANGED)
    assert age.frames(CHANGED[0] + 2, *CHANGED) == 2.0
    assert age.frames(CHANGED[0], *CHANGED) == 1.0


def test_what_was_dropped_was_never_shown() -> None:
    age = VersionAge(library())
    before = age.frames(5, *CHANGED)
    age.sent(*CHANGED)
    age.settled(*CHANGED, delivered=False)
    assert age.frames(5, *CHANGED) == before
    age.sent(*CHANGED)
    age.settled(*CHANGED, delivered=True)
    age.sent(*CHANGED)
    age.settled(*CHANGED, delivered=False)
    assert age.frames(5, *CHANGED) == 5 - CHANGED[0], "it has arrived once"


def test_a_group_of_frames_begins_with_what_was_shown_before_it() -> None:
    age, start = VersionAge(library()), library().manifest.gof_starts[1]
    age.sent(*CHANGED)
    tile = library().entry(start).tiles[0].tile
    assert age.frames(start + 2, start, tile) == 3.0
    age.settled(*CHANGED, delivered=True)
    assert age.frames(start + 2, start, tile) == 3.0, "ids of another group"
    assert age.frames(start + 2, *CHANGED) == start + 2 - CHANGED[0], "the group before may still be on display"
    age.clear()
    assert age.frames(CHANGED[0], *CHANGED) == CHANGED[0] + 1


def test_a_viewer_may_stand_still_before_a_border_that_the_server_has_crossed() -> None:
    age, start = VersionAge(library()), library().manifest.gof_starts[1]
    age.sent(*CHANGED)
    shown = age.shown_with(CHANGED[0], [])
    assert (shown >= 0).any()
    age.sent(start, library().entry(start).tiles[0].tile)
    np.testing.assert_array_equal(age.shown_with(CHANGED[0], []), shown)
    age.settled(*CHANGED, delivered=False)
    assert (age.shown_with(CHANGED[0], []) < 0).all()


def test_what_a_client_holds_of_an_earlier_session_has_arrived() -> None:
    age = VersionAge(library())
    age.held([CHANGED])
    assert age.frames(CHANGED[0] + 2, *CHANGED) == 2.0
    age.sent(*CHANGED)
    age.settled(*CHANGED, delivered=False)
    assert age.frames(CHANGED[0] + 2, *CHANGED) == 2.0


def test_what_the_bundle_does_not_have_cannot_be_held() -> None:
    """A client that named a frame beyond the clip's end ended its session with an error of the server's."""
    frames, tiles = library().manifest.frames, len(library().entry(0).tiles)
    age = VersionAge(library())
    age.held([(frames, 0), (2**31 - 1, 0), (0, tiles), (0, 2**16 - 1), (CHANGED[0], 2**16 - 1)])
    assert age.frames(CHANGED[0], *CHANGED) == CHANGED[0] + 1
    assert age.frames(frames - 1, library().manifest.gof_starts[-1], 0) >= 1.0


@given(st.lists(st.tuples(st.sampled_from(TILES), st.sampled_from(["sent", "delivered", "dropped"])), max_size=25))
def test_it_never_exceeds_the_time_since_the_group_began(steps: list[tuple[tuple[int, int], str]]) -> None:
    age = VersionAge(library())
    for key, what in steps:
        if what == "sent":
            age.sent(*key)
        else:
            age.settled(*key, delivered=what == "delivered")
        ages = np.array([age.frames(5, *each) for each in TILES])
        assert (ages >= 1.0).all() and (ages <= 6.0).all()
        assert what != "sent" or age.frames(5, *key) <= max(5 - key[0], 1)


@pytest.fixture(scope="module")
def changing(tmp_path_factory: pytest.TempPathFactory) -> SceneLibrary:
    """A clip with updates, the first of which is followed by another one of some of its splats."""
    return moving_library(str(tmp_path_factory.mktemp("bundles") / "moving"), 1)


def updates_of(served: SceneLibrary) -> list[tuple[int, int]]:
    """(media frame, tile) of the updates of the first group."""
    tiles = [(frame, tile) for frame in range(MOVING_FRAMES) for tile in served.entry(frame).tiles]
    return [(frame, tile.tile) for frame, tile in tiles if tile.kind == TileKind.UPDATE]


def of_one_splat(served: SceneLibrary) -> list[tuple[int, int]]:
    """Two or more updates of one splat, in order."""
    every = updates_of(served)
    ids = np.concatenate([served.tile_ids(*key) for key in every])
    most = int(np.bincount(ids).argmax())
    return [key for key in every if most in served.tile_ids(*key)]


def test_updates_are_lacked_from_the_first_on_that_did_not_come(changing: SceneLibrary) -> None:
    age, (first, *_, last) = VersionAge(changing), of_one_splat(changing)
    ids, again = changing.tile_ids(*first), changing.tile_ids(*last)
    assert age.update_frames(first[0], *first) == 1.0
    assert age.update_frames(first[0] + 4, *first) == 5.0
    both = float(np.isin(again, ids).mean())
    assert age.update_frames(last[0], *last) == pytest.approx(1.0 + both * (last[0] - first[0]))
    age.sent(*last)
    assert age.update_frames(last[0], *last) == 1.0


@pytest.mark.parametrize("how", ["dropped", "evicted"])
def test_an_update_that_was_lost_is_lacked_again(changing: SceneLibrary, how: str) -> None:
    age, (first, *_, last) = VersionAge(changing), of_one_splat(changing)
    age.sent(*first)
    if how == "dropped":
        age.settled(*first, delivered=False)
    else:
        age.settled(*first, delivered=True)
        age.lost(*first)
    both = float(np.isin(changing.tile_ids(*last), changing.tile_ids(*first)).mean())
    assert age.update_frames(last[0], *last) == pytest.approx(1.0 + both * (last[0] - first[0]))


@given(st.data())
def test_of_what_came_nothing_is_lacked_and_the_rest_no_longer_than_the_group(
    changing: SceneLibrary, data: st.DataObject
) -> None:
    age, every = VersionAge(changing), updates_of(changing)
    for key in data.draw(st.lists(st.sampled_from(every), max_size=12)):
        if data.draw(st.booleans()):
            age.sent(*key)
            assert age.update_frames(key[0], *key) == 1.0
        assert 1.0 <= age.update_frames(MOVING_FRAMES - 1, *key) <= MOVING_FRAMES


@pytest.mark.parametrize("whole", [True, False])
def test_of_a_clip_that_is_kept_whole_no_group_is_past(whole: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if not whole:
        monkeypatch.setattr("cags_common.bundle.manifest.MAX_WHOLE_SPLATS", 0)
    served = library(frames=9, gof=3)
    age = VersionAge(served)
    for frame in (0, 6, 3):  # as a viewer jumps
        for entry in served.entry(frame).tiles:
            age.sent(frame, entry.tile)
    shown = [bool((age.shown_with(frame, []) >= 0).any()) for frame in (0, 3, 6)]
    assert shown == ([True] * 3 if whole else [False, False, True])
