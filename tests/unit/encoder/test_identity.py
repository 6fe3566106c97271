import numpy as np
import pytest

from cags_common.errors import SceneError
from cags_encoder.frames.identity import IdentityTracker, match_rows
from support.codec_scenes import cloud, with_changes

RANDOM = np.random.default_rng(0)


def test_rows_that_agree_keep_their_place() -> None:
    before = cloud(200)
    after = with_changes(before, means=before.means + np.float32(0.001))
    assert np.array_equal(match_rows(before, after), np.arange(200))


def test_a_new_order_every_frame_is_undone() -> None:
    before = cloud(300)
    order = RANDOM.permutation(300)
    assert np.array_equal(match_rows(before, before.take(order)), order)


def test_a_new_count_is_matched_by_attributes() -> None:
    before = cloud(300)
    rows = match_rows(before, before.take(np.arange(50, 300)))
    assert np.array_equal(rows, np.arange(50, 300))


def test_no_identity_is_given_twice_and_lost_ones_are_taken_over() -> None:
    tracker = IdentityTracker()
    splats = cloud(200)
    first, continuous = tracker.identify(200, None, None, "x")
    assert not continuous
    moved = with_changes(splats, means=np.concatenate([splats.means[:150], splats.means[150:] + 50]))
    moved = moved.take(RANDOM.permutation(200))
    second, continuous = tracker.identify(200, None, match_rows(splats, moved), "x")
    assert continuous
    assert sorted(second) == sorted(first)
    third, _ = tracker.identify(260, None, match_rows(moved, cloud(260, 0)), "x")
    assert len(np.unique(third)) == 260


def test_frames_without_anything_in_common_are_not_continuous() -> None:
    tracker = IdentityTracker()
    before, far = cloud(100, 1), cloud(100, 2)
    tracker.identify(100, None, None, "x")
    rows = match_rows(before, with_changes(far, means=far.means + 1000))
    assert not tracker.identify(100, None, rows, "x")[1]


def test_identities_that_the_source_knows_are_taken_and_checked() -> None:
    tracker = IdentityTracker()
    given = np.array([5, 9, 7], np.int32)
    assert tracker.identify(3, given, None, "x")[0].tolist() == [5, 9, 7]
    assert tracker.identify(2, given[:2], None, "x")[1]
    for bad in ([1, 1], [-1, 2]):
        with pytest.raises(SceneError, match="frame 7: its splat identities"):
            tracker.identify(2, np.array(bad, np.int32), None, "frame 7")
