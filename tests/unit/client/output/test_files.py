"""Sinks beside the display: what they keep, and when it is written."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import av
import cv2
import numpy as np
import pytest

from cags_client.output.files import (
    PictureSpool,
    StagesSink,
    bytes_of,
    check_picture_folder,
    check_save,
    open_save,
    stage_path,
)
from cags_client.output.spool import ScoringSpool
from cags_common.errors import ConfigError, OutputError
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


def test_pictures_go_only_where_nothing_else_lies(tmp_path: Path) -> None:
    """A play that began at another frame would leave pictures of the one before among its own."""
    bundle, old, stages, empty = (tmp_path / name for name in ("room.cags", "old.frames", "stages", "empty"))
    named = {bundle: "manifest.json", old: "frame_00012.png", stages: "frame_0030_restored.png", empty: ".hidden"}
    for folder, name in named.items():
        folder.mkdir()
        (folder / name).touch()
    for fine in (empty, tmp_path / "new", f"{tmp_path}/new.1/", tmp_path / "clip.mp4", tmp_path / "clip.MP4"):
        check_save(str(fine))
    with pytest.raises(ConfigError, match=r"room\.cags: the folder holds other files \(manifest\.json\)"):
        check_save(str(bundle))
    with pytest.raises(ConfigError, match=r"old\.frames: the folder holds other files \(frame_00012\.png\)"):
        check_save(str(old))
    with pytest.raises(ConfigError, match=r"--stages .*stages: the folder holds other files \(frame_0030_restored"):
        check_picture_folder("--stages", stages)
    (tmp_path / "file").touch()
    for thing in (tmp_path / "file", Path("/dev/full")):
        with pytest.raises(ConfigError, match="is no folder; give the name of a new one"):
            check_save(str(thing))
    with pytest.raises(ConfigError, match=r"x\.mkv: \.mkv is no format to record"):
        check_save("x.mkv")
    (tmp_path / "folder.mp4").mkdir()
    with pytest.raises(ConfigError, match="is a folder"):
        check_save(str(tmp_path / "folder.mp4"))


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 6), (4, 1), (3, 5), (2, 2)])
def test_clips_of_any_size_are_written(tmp_path: Path, height: int, width: int) -> None:
    sink = open_save(str(tmp_path / "clip.MP4"), 30.0)
    for frame in range(3):
        shown = presented(frame)
        shown.rgb = np.full((height, width, 3), 0.5, np.float32)
        sink.show(shown, {})
    sink.close(completed=True)
    with av.open(str(tmp_path / "clip.MP4")) as clip:
        read = [frame.to_ndarray(format="rgb24") for frame in clip.decode(video=0)]
    assert [picture.shape for picture in read] == [(max(height & ~1, 2), max(width & ~1, 2), 3)] * 3
    assert abs(read[0].astype(int) - 128).max() < 8


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
