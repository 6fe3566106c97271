"""From presented frames to what the page shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cags_client.frame.painting import StagedPictures
from cags_client.frame.presented import PresentedFrame
from cags_client.output.page import LiveView, ShownFrame, ViewSettings
from cags_client.output.page.sink import ViewSink
from cags_common.geometry import Camera
from cags_common.passes import PassPlan
from support.live_page import INTRINSICS, StillWalk

NOTHING = PassPlan(frozenset())


class Watched(LiveView):
    """A view that keeps what it is shown."""

    def __init__(self) -> None:
        super().__init__(ViewSettings(view_port=0), StillWalk())
        self.frames: list[ShownFrame] = []

    def show(self, shown: ShownFrame) -> None:
        self.frames.append(shown)


def presented(frame: int) -> PresentedFrame:
    picture = np.zeros((480, 640, 3), np.float32)
    depth = np.full((480, 640), np.inf, np.float32)
    camera = Camera(INTRINSICS, StillWalk().pose_at(0))
    return PresentedFrame(
        frame,
        camera,
        StagedPictures(picture, picture, depth, depth),
        None,
        None,
        2.5,
        False,
        {"raster": 9.0},
        NOTHING,
    )


@pytest.fixture
def view() -> Watched:
    return Watched()


def test_a_frame_without_a_reference_still_shows(view: Watched) -> None:
    ViewSink(view).show(presented(4), {"time_us": 0, "lod_mean": 2.5, "missed": False})
    (shown,) = view.frames
    assert set(shown.pictures) == {"restored", "distorted"}
    assert (shown.frame, shown.occluded, shown.reference_camera) == (4, None, None)
    assert shown.stats["lod_mean"] == 2.5
    assert shown.stages_ms == {"raster": 9.0}


def test_a_frame_that_was_brought_up_says_so(view: Watched) -> None:
    small, large = np.zeros((240, 320, 3), np.float32), np.zeros((480, 640, 3), np.float32)
    for frame in (presented(1), replace(presented(2), pictures=StagedPictures(large, small, small[..., 0]))):
        ViewSink(view).show(frame, {})
    assert [shown.resolution for shown in view.frames] == ["full", "half"]


def test_goodput_is_the_last_second_and_starts_again_after_a_seek(view: Watched) -> None:
    sink = ViewSink(view)
    for k in range(90):
        sink.show(presented(k), {"time_us": k * 33_333, "bytes_tiles": 4_000, "bytes_reference": 1_000})
    assert view.frames[0].stats["goodput_mbps"] is None
    assert view.frames[-1].stats["goodput_mbps"] == pytest.approx(5_000 * 8 * 30 / 1e6, rel=0.01)
    sink.show(presented(0), {"time_us": 0, "bytes_tiles": 10**9})
    assert view.frames[-1].stats["goodput_mbps"] is None
