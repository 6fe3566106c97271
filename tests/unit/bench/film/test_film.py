"""Films: what was on the display at every media frame, and what should have been."""

from __future__ import annotations

from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from cags_bench.film.film import Film, FilmMaker
from cags_bench.film.writing import STRIP_FRAMES, write_clip, write_strip
from cags_client.settings import ClientSettings
from cags_common.errors import ConfigError, OutputError
from cags_common.geometry import F32, Camera, Pose

CAMERA = ClientSettings(width=64, height=48).intrinsics


def camera(x: float) -> Camera:
    return Camera(CAMERA, Pose((x, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)))


def truth(frame: int, seen_from: Camera) -> tuple[F32, F32]:
    """Red says the frame, green the place."""
    rgb = np.zeros((48, 64, 3), np.float32)
    rgb[..., 0], rgb[..., 1] = frame / 255, seen_from.pose.position[0] / 255
    return rgb, np.ones((48, 64), np.float32)


def picture(value: int) -> np.ndarray:
    return np.full((48, 64, 3), value, np.uint8)


@pytest.fixture
def maker():
    with FilmMaker(truth, 30.0) as making:
        yield making


def filmed(maker: FilmMaker, frames: range) -> Film:
    for frame in frames:
        maker.show(frame, camera(frame), picture(frame * 10))
    return maker.film()


def test_every_frame_is_in_the_film(maker: FilmMaker) -> None:
    film = filmed(maker, range(3, 8))
    assert film.frames == (3, 4, 5, 6, 7)
    assert film.size == (64, 48)
    assert [int(shown[0, 0, 0]) for shown, _ in film.pairs()] == [30, 40, 50, 60, 70]
    assert [int(true[0, 0, 0]) for _, true in film.pairs()] == [3, 4, 5, 6, 7]


def test_a_frame_that_was_not_shown_repeats_the_picture_before_and_not_the_truth(maker: FilmMaker) -> None:
    maker.show(0, camera(0), picture(10))
    maker.show(4, camera(40), picture(50))
    film = maker.film()
    assert film.frames == (0, 1, 2, 3, 4)
    assert [int(shown[0, 0, 0]) for shown, _ in film.pairs()] == [10, 10, 10, 10, 50]
    assert [int(true[0, 0, 0]) for _, true in film.pairs()] == [0, 1, 2, 3, 4]
    assert [int(true[0, 0, 1]) for _, true in film.pairs()] == [0, 10, 20, 30, 40], "the viewer moved on meanwhile"


def test_a_film_leaves_nothing_behind() -> None:
    with FilmMaker(truth, 30.0) as maker:
        path = filmed(maker, range(2)).shown.path
        assert path.exists()
    assert not path.parent.exists()


@pytest.mark.parametrize("beside_truth", [False, True])
def test_a_clip_has_every_frame(maker: FilmMaker, tmp_path: Path, beside_truth: bool) -> None:
    film = filmed(maker, range(12))
    write_clip(film, tmp_path / "film.mp4", beside_truth=beside_truth)
    with av.open(str(tmp_path / "film.mp4")) as container:
        pictures = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
        rate = container.streams.video[0].average_rate
    assert len(pictures) == 12
    assert rate == 30
    assert pictures[0].shape == (48, 128 if beside_truth else 64, 3)
    for number, shown in enumerate(pictures):
        assert abs(int(shown[24, 32, 1]) - number * 10) < 4


def test_a_clip_that_cannot_be_written_is_refused(maker: FilmMaker, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"film\.mp4"):
        write_clip(filmed(maker, range(2)), tmp_path / "nowhere" / "film.mp4", beside_truth=False)


def test_a_strip_shows_twelve_frames_what_they_should_have_been_and_the_error(maker: FilmMaker, tmp_path: Path) -> None:
    film = filmed(maker, range(2, 20))
    write_strip(film, 4, [30.0 + n if n % 2 else None for n in range(18)], tmp_path / "strip.png")
    strip = cv2.imread(str(tmp_path / "strip.png"))[..., ::-1]
    bar = strip.shape[0] - 3 * 48
    assert strip.shape[1] == STRIP_FRAMES * 64
    assert [int(strip[bar + 24, 32 + 64 * n, 0]) for n in range(12)] == [10 * frame for frame in range(4, 16)]
    assert [int(strip[bar + 72, 32 + 64 * n, 0]) for n in range(12)] == list(range(4, 16))
    assert int(strip[bar + 120, 32, 2]) == 255, "an error of 40 in blue, four times as large, above grey"


@pytest.mark.parametrize(("start", "message"), [(1, "give 2 to 3"), (4, "give 2 to 3"), (99, "give 2 to 3")])
def test_a_strip_outside_of_the_film_is_refused(maker: FilmMaker, tmp_path: Path, start: int, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        write_strip(filmed(maker, range(2, 15)), start, [None] * 13, tmp_path / "strip.png")


def test_a_film_that_is_too_short_for_a_strip_says_so(maker: FilmMaker, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="play more frames"):
        write_strip(filmed(maker, range(3)), 0, [None] * 3, tmp_path / "strip.png")
