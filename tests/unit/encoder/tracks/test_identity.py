"""One identity is one unbroken track."""

import numpy as np
import pytest

from cags_common.errors import SceneError
from cags_encoder.tracks.identity import IdentityTracker
from support.codec_scenes import cloud, with_changes

RANDOM = np.random.default_rng(0)


def test_identities_follow_splats_through_any_order() -> None:
    tracker, splats = IdentityTracker(), cloud(300)
    first, continuous = tracker.identify(splats, None, "x")
    assert not continuous
    order = RANDOM.permutation(300)
    moved = with_changes(splats, means=splats.means + np.float32(0.001))
    second, continuous = tracker.identify(moved.take(order), None, "x")
    assert continuous
    assert np.array_equal(second, first[order])


def test_a_splat_that_is_not_found_again_is_a_new_one() -> None:
    tracker, splats = IdentityTracker(), cloud(200)
    first, _ = tracker.identify(splats, None, "x")
    means = splats.means.copy()
    means[150:] += 50 * RANDOM.normal(size=(50, 3)).astype(np.float32)
    second, continuous = tracker.identify(with_changes(splats, means=means), None, "x")
    assert continuous
    assert np.array_equal(second[:150], first[:150])
    assert not np.isin(second[150:], first).any()
    assert len(np.unique(second)) == 200


def test_a_splat_that_is_gone_for_a_frame_has_ended() -> None:
    splats = cloud(200)
    some = np.arange(150)
    for known in (False, True):
        tracker = IdentityTracker()
        rows = (np.arange(200), some, np.arange(200))
        ids = [tracker.identify(splats.take(r), r.astype(np.int32) if known else None, "x")[0] for r in rows]
        assert np.array_equal(ids[2][:150], ids[0][:150])
        assert ids[2][150:].min() > ids[0].max()


def test_identities_that_the_source_knows_are_taken_and_checked() -> None:
    tracker, splats = IdentityTracker(), cloud(3)
    given = np.array([5, 9, 7], np.int32)
    first, _ = tracker.identify(splats, given, "x")
    second, continuous = tracker.identify(splats.take(np.array([2, 0])), given[[2, 0]], "x")
    assert continuous
    assert np.array_equal(second, first[[2, 0]])
    for bad in ([1, 1, 2], [-1, 2, 3], [1, 2]):
        with pytest.raises(SceneError, match="frame 7: its splat identities"):
            tracker.identify(splats, np.array(bad, np.int32), "frame 7")


def test_the_source_s_identities_hold_while_splats_fly() -> None:
    """Only the source can know these identities: every splat moves by many times its size, in its own direction."""
    tracker, splats, rows = IdentityTracker(), cloud(200), np.arange(200, dtype=np.int32)
    first, _ = tracker.identify(splats, rows, "x")
    flown = with_changes(splats, means=splats.means + RANDOM.normal(size=(200, 3)).astype(np.float32))
    assert np.array_equal(tracker.identify(flown, rows, "x")[0], first)


def test_rows_are_not_believed_across_a_cut_or_a_new_order() -> None:
    splats, rows = cloud(200, 1), np.arange(200, dtype=np.int32)
    cut = with_changes(cloud(200, 2), means=cloud(200, 2).means + 1000)
    tracker = IdentityTracker()
    first, _ = tracker.identify(splats, rows, "x")
    second, continuous = tracker.identify(cut, rows, "x")
    assert not continuous
    assert not np.isin(second, first).any()
    order = RANDOM.permutation(200)
    third, continuous = tracker.identify(cut.take(order), rows, "x")
    assert continuous
    assert np.array_equal(third, second[order])


def test_rows_that_shift_in_mid_clip_are_not_believed() -> None:
    """A tool removes one splat and appends another, so later rows are other splats than before."""
    tracker, splats, rows = IdentityTracker(), cloud(200), np.arange(200, dtype=np.int32)
    first, _ = tracker.identify(splats, rows, "x")
    shifted = np.r_[np.arange(100), np.arange(101, 200), 0]
    means = splats.means[shifted].copy()
    means[-1] += 20
    second, continuous = tracker.identify(with_changes(splats.take(shifted), means=means), rows, "x")
    assert continuous
    assert np.array_equal(second[:-1], first[shifted[:-1]])
    assert second[-1] not in first


def test_a_source_may_know_identities_of_some_frames_alone() -> None:
    tracker, splats, rows = IdentityTracker(), cloud(200), np.arange(200, dtype=np.int32)
    ids = [tracker.identify(splats, known, "x")[0] for known in (rows, None, None, rows, rows)]
    assert all(np.array_equal(each, ids[0]) for each in ids)


def test_frames_without_anything_in_common_are_not_continuous() -> None:
    tracker = IdentityTracker()
    before, far = cloud(100, 1), cloud(100, 2)
    tracker.identify(before, None, "x")
    assert not tracker.identify(with_changes(far, means=far.means + 1000), None, "x")[1]
