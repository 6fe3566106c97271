"""What ``cags-bench motion`` counts of what frames hand to a renderer."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cags_bench.motion.experiment import _upload_checks
from cags_bench.motion.uploads import frame_uploads
from cags_common.bundle import BundleReader
from support.moving_bundle import write_moving
from support.small_motion import Clip, looks, motion, moving, written
from support.small_store import manifest


@pytest.fixture
def clip(tmp_path: Path) -> Clip:
    """Two splats that move a metre along x in each of three frames after the first."""
    frames = [[looks([0, 1], 5.0), motion((0, 0), 2, [0, 1, 2, 3])], [], [], []]
    return written(tmp_path, moving(manifest(4, (0,))), frames)


def test_rows_and_bytes_of_a_clip_of_two_moving_splats(clip: Clip) -> None:
    line = frame_uploads(clip.reader)
    assert (line["rows_moved_a_frame"], line["rows_changed_a_frame"], line["rows_that_differ_a_frame"]) == (2, 0, 2)
    assert line["upload_bytes_a_frame"] == 2 * 36
    samples = 4 * 3 * 4  # numbers of three parts at four samples
    assert line["upload_bytes_a_frame_device_motion"] == round(2 * (44 + samples) / 3)
    assert all(check["ok"] for check in _upload_checks("clip", line))


def test_every_row_that_differs_is_told_of(tmp_path: Path) -> None:
    reader: BundleReader = write_moving(str(tmp_path / "clip.cags"), 3)
    line = frame_uploads(reader)
    assert line["rows_that_differ_and_are_not_told_of"] == 0 < line["rows_that_differ_a_frame"]


def test_rows_that_are_told_of_for_nothing_fail_the_check() -> None:
    line = {"rows_that_differ_and_are_not_told_of": 1, "rows_moved_a_frame": 30, "rows_changed_a_frame": 1}
    checks = _upload_checks("clip", line | {"rows_that_differ_a_frame": 10})
    assert not np.any([check["ok"] for check in checks])
