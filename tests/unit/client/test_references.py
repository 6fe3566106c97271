"""The reference video: pictures in order, what a gap does, and which picture a frame gets."""

from __future__ import annotations

import numpy as np
import pytest

from cags_client.references import KEPT, References
from cags_common.errors import DecodeError
from cags_common.geometry import Intrinsics, Pose
from cags_common.video.h264 import H264Encoder
from cags_protocol.messages import ReferenceFrame

VIEW = Intrinsics.of_fov(64, 48, 1.2, 1.0)


class Video:
    """A server's reference video: a grey level a picture."""

    def __init__(self) -> None:
        self._encoder, self._seq = H264Encoder(VIEW.width_px, VIEW.height_px, 30), 0

    def picture(self, frame: int, *, idr: bool = False, view: Intrinsics = VIEW) -> tuple[ReferenceFrame, memoryview]:
        self._seq += 1
        grey = np.full((VIEW.height_px, VIEW.width_px, 3), 0.1 + 0.03 * frame, np.float32)
        unit = self._encoder.encode(grey, idr=idr or self._seq == 1)
        message = ReferenceFrame(frame, self._seq, Pose.identity(), view, idr or self._seq == 1)
        return message, memoryview(unit)


def grey(references: References, frame: int, max_age: int = 0) -> float | None:
    picture = references.newest(frame, max_age)
    return None if picture is None else float(picture.rgb.mean())


def test_pictures_belong_to_their_frames() -> None:
    references, video = References(), Video()
    for frame in range(3):
        assert references.add(*video.picture(frame))
        assert references.last_decoded == frame + 1
    for frame in range(3):
        assert grey(references, frame) == pytest.approx(0.1 + 0.03 * frame, abs=0.01)
    assert grey(references, 4, max_age=1) is None
    assert grey(references, 4, max_age=2) == pytest.approx(0.16, abs=0.01), "the newest that is not too old"
    assert grey(references, -1, max_age=9) is None, "never one of a frame to come"


def test_after_a_gap_nothing_is_shown_until_a_picture_stands_alone() -> None:
    references, video = References(), Video()
    assert references.add(*video.picture(0))
    video.picture(1)  # lost
    assert not references.add(*video.picture(2))
    assert not references.add(*video.picture(3)), "in order again, but of pictures that are not there"
    assert grey(references, 3, max_age=2) is None
    assert references.last_decoded == 1
    assert references.add(*video.picture(4, idr=True))
    assert references.add(*video.picture(5))
    assert grey(references, 5) == pytest.approx(0.25, abs=0.01)


def test_a_late_picture_does_no_harm() -> None:
    references, video = References(), Video()
    assert references.add(*video.picture(0))
    late = video.picture(1)
    assert not references.add(*video.picture(2))
    assert references.add(*video.picture(3, idr=True))
    assert references.add(*late), "no reason to ask for another IDR"
    assert grey(references, 1) is None
    assert references.add(*video.picture(4)), "the decoder was not disturbed"


def test_a_picture_of_another_size_than_it_says_is_refused() -> None:
    references, video = References(), Video()
    with pytest.raises(DecodeError, match="reference 1 is 64x48, said 32x24"):
        references.add(*video.picture(0, view=Intrinsics.of_fov(32, 24, 1.2, 1.0)))
    assert references.newest(0, 9) is None


@pytest.mark.parametrize("damage", [b"", b"\x00\x00\x01"], ids=["empty", "no picture"])
def test_after_damage_the_video_waits_for_an_idr(damage: bytes) -> None:
    references, video = References(), Video()
    assert references.add(*video.picture(0))
    message, _ = video.picture(1)
    with pytest.raises(DecodeError):
        references.add(message, memoryview(damage))
    assert not references.add(*video.picture(2)), "it would be coded against a picture that is not there"
    assert references.add(*video.picture(3, idr=True))


def test_pictures_are_bounded_and_forgotten_on_a_jump_while_the_video_goes_on() -> None:
    references, video = References(), Video()
    for frame in range(KEPT + 2):
        assert references.add(*video.picture(frame))
    assert grey(references, 1, max_age=1) is None
    assert grey(references, 2) is not None
    references.reset()
    assert references.newest(KEPT + 1, KEPT) is None
    assert references.add(*video.picture(KEPT + 2))


def test_another_servers_video_begins_anew_and_the_pictures_stay() -> None:
    references, video = References(), Video()
    for frame in range(3):
        assert references.add(*video.picture(frame))
    references.restart()
    assert references.last_decoded == 0
    assert grey(references, 2) is not None
    other = Video()
    other.picture(3)  # the first of the other's, lost
    assert not references.add(*other.picture(4))
    assert references.add(*other.picture(5, idr=True))
