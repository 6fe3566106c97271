"""Sinks beside the display: what they keep, and when it is written."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from cags_client.output.files import PictureSpool, StagesSink, bytes_of, stage_path
from cags_client.output.spool import ScoringSpool
from cags_common.errors import OutputError
from cags_common.geometry import F32, Camera, Intrinsics, Pose

CAMERA = Camera(Intrinsics(6, 4, 5.0, 5.0, 3.0, 2.0), Pose.looking_at((0.0, 0.0, -2.0), (0.0, 0.0, 0.0)))


def picture(level: float) -> F32:
    return np.full((4, 6, 3), level, np.float32)


def presented(frame: int, *, aligned: bool = True) -> Any:
    """As much of a presented frame as sinks look at."""
    return SimpleNamespace(
        frame=frame,
        camera=CAMERA,
        distorted=picture(0.2),
        rgb=picture(0.4),
        aligned_rgb=picture(0.6) if aligned else None,
        correction=picture(0.6),
        reference=SimpleNamespace(coded=np.full((3, 5, 3), 0.8, np.float32)),
    )


def test_bytes_are_rounded_and_saturate() -> None:
    levels = np.array([[[0.0, 0.5 / 255 + 1e-4, 1.0], [254.4 / 255, 254.6 / 255, 1.7]]], np.float32)
    assert bytes_of(levels).tolist() == [[[0, 1, 255], [254, 255, 255]]]


def test_stages_are_written_once_the_play_has_ended(tmp_path: Path) -> None:
    sink = StagesSink(tmp_path / "stages", 2)
    for frame in range(4):
        sink.show(presented(frame, aligned=frame == 0), {})
    assert not list((tmp_path / "stages").iterdir()), "coding pictures while playing costs frames"
    sink.close(completed=True)
    names = {path.name for path in (tmp_path / "stages").iterdir()}
    first = {f"frame_0000_{name}.png" for name in ("reference", "distorted", "correction", "aligned", "restored")}
    assert names == first | {f"frame_0002_{name}.png" for name in ("reference", "distorted", "correction", "restored")}
    read = cv2.imread(str(stage_path(tmp_path / "stages", 0, "reference")))
    assert read is not None
    assert read.shape == (3, 5, 3)
    assert set(np.unique(read)) == {204}


def test_stages_of_a_play_that_failed_are_left_out(tmp_path: Path) -> None:
    sink = StagesSink(tmp_path, 1)
    sink.show(presented(0), {})
    sink.close(completed=False)
    assert not list(tmp_path.iterdir())


def test_the_spool_scores_what_was_shown() -> None:
    spool = ScoringSpool()
    spool.show(presented(3), {})
    spool.show(presented(5, aligned=False), {})
    spool.close(completed=True)
    truth = picture(0.4), np.ones((4, 6), np.float32)
    scored = list(spool.scores(lambda frame, camera: truth))
    assert [frame for frame, _, _ in scored] == [3, 5]
    assert scored[0][1]["psnr_restored_db"] > 60 > scored[0][1]["psnr_aligned_db"]
    assert "psnr_aligned_db" not in scored[1][1]
    assert scored[1][2].tolist() == bytes_of(truth[0]).tolist()


def test_a_full_disk_is_one_clear_line(monkeypatch: pytest.MonkeyPatch) -> None:
    class Full:
        def write(self, data: memoryview) -> int:
            raise OSError(28, "No space left on device")

        def close(self) -> None:
            """Nothing was opened."""

    spool = PictureSpool()
    with spool:
        spool._file.close()
        monkeypatch.setattr(spool, "_file", Full())
        with pytest.raises(OutputError, match=r"cannot keep pictures .*No space left"):
            spool.put(bytes_of(picture(0.1)))
