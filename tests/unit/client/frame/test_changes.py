"""What has changed since a reference was made, and where a view shows it."""

from __future__ import annotations

import numpy as np

from cags_client.frame.changes import MOVED_PX, Changes
from cags_common.correction import changed_cells
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.splats import Splats
from support.codec_scenes import cloud, with_changes

CAMERA = Camera(Intrinsics.of_fov(128, 64, 1.2, 0.7), Pose.identity())
FOCAL_PX = 60.0
FAR = np.full((64, 128), 100.0, np.float32)


def committed(changes: Changes, mark: int, *rows: int, frame: int = 10, began: int = 0) -> None:
    """``rows`` change with ``frame`` by what begins in frame ``began``."""
    changes.committed(frame, mark, np.array(rows, np.intp), np.full(len(rows), began, np.int32))


def line(shift: float = 0.0) -> Splats:
    """Five small splats from left to right, four metres away."""
    means = np.zeros((5, 3), np.float32)
    means[:, 0], means[:, 2] = np.arange(-2, 3) * 0.8 + shift, 4.0
    return with_changes(cloud(5), means=means, log_scales=np.full((5, 3), np.log(0.02), np.float32))


def veto(changes: Changes, since: tuple[int, int | None], splats: Splats, depth: np.ndarray = FAR) -> np.ndarray:
    """Where a view of that depth shows what has changed."""
    return changed_cells(changes.spheres(since, splats, CAMERA, FOCAL_PX), CAMERA, depth)


def test_what_a_reference_assumes_has_not_changed_for_it() -> None:
    changes = Changes()
    committed(changes, 3, 0, 1)
    changes.used(3)
    assert not changes.since(10, 3)
    assert not veto(changes, (10, 3), line()).any()
    committed(changes, 4, 2)
    assert changes.since(10, 3)
    assert not changes.since(10, 4)


def test_the_veto_lies_where_a_changed_splat_is_seen() -> None:
    changes = Changes()
    changes.shown(10, line().means)
    changes.used(1)
    committed(changes, 2, 4)
    columns = np.flatnonzero(veto(changes, (10, 1), line()).any(axis=0))
    assert len(columns)
    assert columns.min() >= 4, "on the right, of eight cells"
    hidden = veto(changes, (10, 1), line(), np.full((64, 128), 2.0, np.float32))
    assert not hidden.any(), "behind what the view shows"


def test_motion_that_a_difference_assumes_takes_its_correction_along() -> None:
    changes = Changes()
    changes.shown(10, line().means)
    committed(changes, 1)
    assert not changes.since(10, 1)
    assert not veto(changes, (10, 1), line(1.0)).any()


def test_what_has_moved_by_more_than_a_little_counts_as_changed_where_more_is_shown() -> None:
    changes, little = Changes(), 0.5 * MOVED_PX * 4.0 / FOCAL_PX
    changes.shown(10, line().means)
    committed(changes, 2)  # motion, which changes no row
    assert changes.since(10, 1)
    assert not veto(changes, (10, 1), line(little)).any()
    assert veto(changes, (10, 1), line(4 * little)).any()
    committed(changes, 1)  # a reference's own frame goes back to what that assumes
    assert not veto(changes, (10, 1), line(4 * little)).any()


def test_of_a_picture_only_what_has_moved_counts() -> None:
    changes = Changes()
    changes.shown(10, line().means)
    changes.used(1)
    committed(changes, 2, 4)
    assert not veto(changes, (10, None), line()).any()
    assert veto(changes, (10, None), line(1.0)).any()


def test_looks_that_begin_after_a_references_frame_have_changed_for_it() -> None:
    changes = Changes()
    changes.shown(10, line().means)
    committed(changes, 1, 0)
    changes.used(1)
    assert not changes.since(10, 1)
    committed(changes, 1, 4, frame=11, began=11)  # by the mark that the reference assumes
    assert changes.since(10, 1)
    for basis in (1, None):
        columns = np.flatnonzero(veto(changes, (10, basis), line()).any(axis=0))
        assert len(columns)
        assert columns.min() >= 4, "only the splat that changed"
    assert not changes.since(11, 1)
    assert not veto(changes, (11, None), line()).any()


def test_what_changed_in_the_round_before_does_not_count_in_the_next() -> None:
    changes = Changes()
    committed(changes, 1, 4, frame=80, began=80)
    committed(changes, 1, frame=0)
    assert not changes.since(0, 1)


def test_what_was_shown_before_a_mark_that_is_older_does_not_come_back() -> None:
    changes = Changes()
    committed(changes, 9, 0)
    committed(changes, 5, 1)  # a late reference: what is shown stays shown
    assert changes.since(10, 5)


def test_another_group_of_frames_begins_anew() -> None:
    changes = Changes()
    changes.shown(10, line().means)
    changes.used(1)
    committed(changes, 2, 1)
    changes.clear()
    assert not changes.since(10, 0)
    assert not veto(changes, (10, None), line(1.0)).any()
