"""The page's pictures, streams and overlays."""

from __future__ import annotations

import av
import cv2
import numpy as np
import pytest

from cags_client.output.page import SceneInfo, ShownFrame, SplatDetail
from cags_client.output.page.overlays import detail_grid, occlusion_grid, reference_outline, tile_boxes
from cags_client.output.page.pictures import Gallery, coloured_depth, coloured_error
from cags_client.output.page.video import H264, JPEG, RAW, PictureStream, codec_string
from cags_common.geometry import Camera, Pose
from support.live_page import INTRINSICS, FakeControls, StillWalk, frames_around, shown_frame

POSE = StillWalk().pose_at(0)


def gallery(controls: FakeControls | None = None) -> Gallery:
    return Gallery(shown_frame(0, POSE), controls.truth if controls else None)


def test_pictures_are_even_bytes_and_made_once() -> None:
    shown = ShownFrame(0, Camera(INTRINSICS, POSE), {"restored": np.full((7, 9, 3), 0.5, np.float32)})
    pictures = Gallery(shown, None)
    image = pictures.picture("restored")
    assert image is not None
    assert image.shape == (6, 8, 3)
    assert image.dtype == np.uint8
    assert int(image.max()) == 128
    assert pictures.picture("restored") is image
    assert pictures.picture("depth") is None
    assert pictures.picture("truth") is None


def test_truth_is_rendered_only_when_it_is_looked_at_and_then_once() -> None:
    controls = FakeControls()
    pictures = gallery(controls)
    assert pictures.picture("distorted") is not None
    assert pictures.scores() == {}
    assert controls.truths == 0
    assert pictures.picture("truth") is not None
    assert pictures.picture("error") is not None
    assert controls.truths == 1
    scores = pictures.scores()
    assert scores["psnr_restored_db"] > scores["psnr_distorted_db"] > 10


def test_error_of_equal_pictures_is_dark_and_void_depth_is_black() -> None:
    image = np.full((4, 4, 3), 0.3, np.float32)
    assert int(coloured_error(image, image).max()) < 5
    depth = np.full((16, 16), np.inf, np.float32)
    assert not coloured_depth(depth).any()
    depth[:8] = np.linspace(1, 4, 16)
    coloured = coloured_depth(depth)
    assert coloured[:8].any()
    assert not coloured[8:].any()


@pytest.mark.parametrize("size", [(48, 64), (130, 98)])
def test_h264_streams_start_with_a_key_picture_and_decode_to_the_same_colours(size: tuple[int, int]) -> None:
    stream = PictureStream(kind=H264, fps=30, crf=10, jpeg_quality=85)
    decoder = av.CodecContext.create("h264", "r")
    for k, colour in enumerate([(200, 60, 40), (20, 180, 90), (240, 240, 240)]):
        image = np.full((*size, 3), colour, np.uint8)
        coded = stream.encode(image, key=k == 2)
        assert coded.key == (k in (0, 2))
        assert coded.codec.startswith("avc1.42")
        assert (coded.height, coded.width) == size
        (frame,) = decoder.decode(av.Packet(coded.data))
        assert np.abs(frame.to_ndarray(format="rgb24").astype(int) - colour).max() <= 6


def test_a_new_size_starts_the_stream_anew() -> None:
    stream = PictureStream(kind=H264, fps=30, crf=22, jpeg_quality=85)
    assert stream.encode(np.zeros((32, 32, 3), np.uint8)).key
    assert not stream.encode(np.zeros((32, 32, 3), np.uint8)).key
    assert stream.encode(np.zeros((64, 32, 3), np.uint8)).key


def test_a_picture_as_it_is_holds_the_same_colours() -> None:
    image = np.full((32, 48, 3), (200, 60, 40), np.uint8)
    coded = PictureStream(kind=RAW, fps=30, crf=22, jpeg_quality=85).encode(image)
    assert (coded.codec, coded.key, len(coded.data)) == (RAW, True, 32 * 48 * 3 // 2)
    planes = np.frombuffer(coded.data, np.uint8).reshape(48, 48)
    assert np.abs(cv2.cvtColor(planes, cv2.COLOR_YUV2RGB_I420).astype(int) - image).max() <= 3


def test_jpeg_pictures_stand_alone() -> None:
    coded = PictureStream(kind=JPEG, fps=30, crf=22, jpeg_quality=85).encode(np.zeros((32, 48, 3), np.uint8))
    assert (coded.codec, coded.key, coded.data[:2]) == (JPEG, True, b"\xff\xd8")


def test_codec_strings_need_a_parameter_set() -> None:
    with pytest.raises(ValueError, match="parameter set"):
        codec_string(b"\x00\x00\x01\x65rest")


def test_occluded_pixels_make_a_grid_a_quarter_of_the_size() -> None:
    grid = occlusion_grid(shown_frame(0, POSE))
    assert grid is not None
    assert grid.values.shape == (120, 160)
    assert grid.values[55, 55] == 255
    assert grid.values[5, 5] == 0
    assert occlusion_grid(ShownFrame(0, Camera(INTRINSICS, POSE), {})) is None


def test_detail_counts_what_is_seen_and_not_what_lies_behind() -> None:
    pose = Pose.identity()
    shown = ShownFrame(0, Camera(INTRINSICS, pose), {}, {"depth": lambda: np.full((480, 640), 2.0, np.float32)})
    means = np.array([[0, 0, 2], [0, 0, 5], [0, 0, -1], [0.5, 0, 2]], np.float32)
    held = SplatDetail(means, np.array([0, 0, 0, -1], np.int32), np.array([1.0, 0.0, 0.0, 0.5], np.float32))
    grid = detail_grid(held, shown).values
    assert grid.shape == (60, 80)
    assert grid[30, 40] == 255
    assert set(np.unique(grid)) == {255}  # nothing of the splat behind


def test_detail_fills_the_surface_between_centres_and_nothing_beside_it() -> None:
    depth = np.full((480, 640), np.inf, np.float32)
    depth[120:360, 160:480] = 2.0
    shown = ShownFrame(0, Camera(INTRINSICS, Pose.identity()), {}, {"depth": lambda: depth})
    means = np.array([[-0.3, 0, 2], [0.3, 0, 2]], np.float32)
    held = SplatDetail(means, np.zeros(2, np.int32), np.array([0.0, 1.0], np.float32))
    grid = detail_grid(held, shown).values
    assert ((grid > 0) == np.isfinite(depth[::8, ::8])).all()
    assert (grid[30, 24], grid[30, 56]) == (1, 255)
    assert (np.diff(grid[30, 20:60].astype(int)) >= 0).all()


def test_tile_boxes_hold_their_splats_and_hide_behind_the_camera() -> None:
    means = np.array([[-1, -1, 4], [1, 1, 6], [0, 0, -5], [1, 0, -4]], np.float32)
    held = SplatDetail(means, np.array([7, 7, 2, 2], np.int32), np.array([0.2, 0.4, 1, 1], np.float32))
    boxes = tile_boxes(held, Camera(INTRINSICS, Pose.identity()))
    assert len(boxes) == 1
    assert boxes[0]["detail"] == pytest.approx(0.3)
    assert len(boxes[0]["lines"]) == 12  # type: ignore[arg-type]
    nobody = SplatDetail(means, np.full(4, -1, np.int32), np.zeros(4, np.float32))
    assert tile_boxes(nobody, Camera(INTRINSICS, Pose.identity())) == []


def test_a_reference_of_the_same_camera_frames_the_picture() -> None:
    camera = Camera(INTRINSICS, POSE)
    lines = np.array(reference_outline(ShownFrame(0, camera, {}, reference_camera=camera), 3.0))
    assert lines.min() == pytest.approx(0, abs=1e-3)
    assert lines.max() == pytest.approx(1, abs=1e-3)
    assert reference_outline(ShownFrame(0, camera, {}), 3.0) == []


def test_lines_through_the_camera_plane_stay_finite() -> None:
    camera = Camera(INTRINSICS, Pose.identity())
    turned = Camera(INTRINSICS, Pose((0, 0, 0), (0.7071, 0, 0.7071, 0)))
    lines = np.array(reference_outline(ShownFrame(0, camera, {}, reference_camera=turned), 3.0) or [[0.0] * 4])
    assert np.isfinite(lines).all()


def test_the_clip_of_the_tests_moves() -> None:
    a, b = [frame.pictures["restored"] for frame in frames_around(2)]
    assert np.abs(a - b).max() > 0.1
    assert SceneInfo("x", 1, 30.0, (0, 1, 0), (0, 0, 0), 1.0, 2).near == 0.2
