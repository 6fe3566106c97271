"""One identity is one unbroken track."""

import numpy as np
import pytest

from cags_common.errors import SceneError
from cags_common.splats import Splats
from cags_encoder.tracks.identity import IdentityTracker
from cags_encoder.tracks.looking import Look
from support.codec_scenes import cloud, with_changes

RANDOM = np.random.default_rng(0)


def followed(*frames: tuple[Splats, np.ndarray | None], name: str = "x") -> list[tuple[np.ndarray, bool]]:
    """Identities of ``frames`` with or without identities of their own, and whether each continues the last."""
    looks = ((name, Look(splats, known)) for splats, known in frames)
    return [(frame.ids, frame.continuous) for frame in IdentityTracker().follow(looks)]


def test_identities_follow_splats_through_any_order() -> None:
    splats, order = cloud(300), RANDOM.permutation(300)
    moved = with_changes(splats, means=splats.means + np.float32(0.001))
    (first, begins), (second, continues) = followed((splats, None), (moved.take(order), None))
    assert not begins
    assert continues
    assert np.array_equal(second, first[order])


def test_a_splat_that_is_not_found_again_is_a_new_one() -> None:
    splats = cloud(200)
    means = splats.means.copy()
    means[150:] += 50 * RANDOM.normal(size=(50, 3)).astype(np.float32)
    (first, _), (second, continuous) = followed((splats, None), (with_changes(splats, means=means), None))
    assert continuous
    assert np.array_equal(second[:150], first[:150])
    assert not np.isin(second[150:], first).any()
    assert len(np.unique(second)) == 200


def test_a_splat_that_is_gone_for_a_frame_has_ended() -> None:
    splats = cloud(200)
    some = np.arange(150)
    for known in (False, True):
        rows = (np.arange(200), some, np.arange(200))
        ids = [ids for ids, _ in followed(*((splats.take(r), r.astype(np.int32) if known else None) for r in rows))]
        assert np.array_equal(ids[2][:150], ids[0][:150])
        assert ids[2][150:].min() > ids[0].max()


def test_identities_that_the_source_knows_are_taken_and_checked() -> None:
    splats, given = cloud(3), np.array([5, 9, 7], np.int32)
    (first, _), (second, continuous) = followed((splats, given), (splats.take(np.array([2, 0])), given[[2, 0]]))
    assert continuous
    assert np.array_equal(second, first[[2, 0]])
    for bad in ([1, 1, 2], [-1, 2, 3], [1, 2]):
        with pytest.raises(SceneError, match="frame 7: its splat identities"):
            followed((splats, np.array(bad, np.int32)), name="frame 7")


def test_the_source_s_identities_hold_while_splats_fly() -> None:
    """Only the source can know these identities: every splat moves by many times its size, in its own direction."""
    splats, rows = cloud(200), np.arange(200, dtype=np.int32)
    flown = with_changes(splats, means=splats.means + RANDOM.normal(size=(200, 3)).astype(np.float32))
    (first, _), (second, _) = followed((splats, rows), (flown, rows))
    assert np.array_equal(second, first)


def test_rows_are_not_believed_across_a_cut_or_a_new_order() -> None:
    splats, rows = cloud(200, 1), np.arange(200, dtype=np.int32)
    cut = with_changes(cloud(200, 2), means=cloud(200, 2).means + 1000)
    order = RANDOM.permutation(200)
    (first, _), (second, cut_goes_on), (third, goes_on) = followed((splats, rows), (cut, rows), (cut.take(order), rows))
    assert not cut_goes_on
    assert not np.isin(second, first).any()
    assert goes_on
    assert np.array_equal(third, second[order])


def test_rows_that_shift_in_mid_clip_are_not_believed() -> None:
    """A tool removes one splat and appends another, so later rows are other splats than before."""
    splats, rows = cloud(200), np.arange(200, dtype=np.int32)
    shifted = np.r_[np.arange(100), np.arange(101, 200), 0]
    means = splats.means[shifted].copy()
    means[-1] += 20
    changed = with_changes(splats.take(shifted), means=means)
    (first, _), (second, continuous) = followed((splats, rows), (changed, rows))
    assert continuous
    assert np.array_equal(second[:-1], first[shifted[:-1]])
    assert second[-1] not in first


def test_a_source_may_know_identities_of_some_frames_alone() -> None:
    splats, rows = cloud(200), np.arange(200, dtype=np.int32)
    ids = [ids for ids, _ in followed(*((splats, known) for known in (rows, None, None, rows, rows)))]
    assert all(np.array_equal(each, ids[0]) for each in ids)


def test_frames_without_anything_in_common_are_not_continuous() -> None:
    before, far = cloud(100, 1), cloud(100, 2)
    _, (_, continuous) = followed((before, None), (with_changes(far, means=far.means + 1000), None))
    assert not continuous


@pytest.mark.parametrize("known_from", [0, 3, 5])
def test_every_frame_comes_once_and_in_order(known_from: int) -> None:
    """However many frames wait for later ones, and whether the source knows the identities of some."""
    splats, rows = cloud(50), np.arange(50, dtype=np.int32)
    for count in range(8):
        frames = [splats.take(slice(at, None)) for at in range(count)]
        given = [rows[at:] if at >= known_from else None for at in range(count)]
        found = followed(*zip(frames, given, strict=True))
        assert [len(ids) for ids, _ in found] == [50 - at for at in range(count)]


def test_a_still_scene_keeps_one_look_and_its_identities() -> None:
    splats, rows = cloud(50), np.arange(50, dtype=np.int32)
    tracker = IdentityTracker()
    frames = list(tracker.follow(("x", Look(splats, rows)) for _ in range(6)))
    assert len(frames) == 6 and [frame.continuous for frame in frames] == [False, *[True] * 5]
    assert all(frame.look is frames[0].look and frame.ids is frames[0].ids for frame in frames)
    copies = IdentityTracker()
    list(copies.follow(("x", Look(with_changes(splats, means=splats.means.copy()), rows)) for _ in range(6)))
    assert tracker.statistics() == copies.statistics()
