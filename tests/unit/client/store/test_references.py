"""The reference video: pictures in order, what a gap does, and which picture a frame gets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cags_client.store.references import KEPT, References
from cags_common.errors import DecodeError
from cags_common.geometry import Intrinsics, Pose
from cags_common.video.h264 import H264Encoder
from cags_protocol.wire.messages import ReferenceFrame, ReferenceKind

VIEW = Intrinsics.of_fov(64, 48, 1.2, 1.0)


class Video:
    """A server's reference video: a grey level a picture."""

    def __init__(self) -> None:
        self._encoder, self._seq = H264Encoder(VIEW.width_px, VIEW.height_px, 30), 0

    def picture(
        self, frame: int, *, idr: bool = False, view: Intrinsics = VIEW, basis: int = 1
    ) -> tuple[ReferenceFrame, memoryview, int]:
        self._seq += 1
        grey = np.full((VIEW.height_px, VIEW.width_px, 3), 0.1 + 0.03 * frame, np.float32)
        unit = self._encoder.encode(grey, idr=idr or self._seq == 1)
        message = ReferenceFrame(frame, self._seq, Pose.identity(), view, idr or self._seq == 1)
        return message, memoryview(unit), basis


def grey(references: References, frame: int, max_age: int = 0) -> float | None:
    picture = references.newest(frame, max_age)
    return None if picture is None or picture.coded is None else float(picture.coded.mean())


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
    message, _, basis = video.picture(1)
    with pytest.raises(DecodeError):
        references.add(message, memoryview(damage), basis)
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


def nothing(frame: int, basis: int, seq: int = 0) -> tuple[ReferenceFrame, memoryview, int]:
    message = ReferenceFrame(frame, seq, Pose.identity(), VIEW, kind=ReferenceKind.NOTHING.value, basis=basis)
    return message, memoryview(b""), basis


def difference(video: Video, frame: int, basis: int) -> tuple[ReferenceFrame, memoryview, int]:
    message, unit, _ = video.picture(frame, basis=basis)
    return replace(message, kind=ReferenceKind.DIFFERENCE.value, basis=basis, knee=0.06), unit, basis


def test_what_says_nothing_is_a_reference_without_a_picture_and_leaves_the_video_whole() -> None:
    references, video = References(), Video()
    assert references.add(*video.picture(0))
    assert references.add(*nothing(1, basis=4, seq=1))
    assert references.add(*video.picture(2)), "no gap"
    silent = references.newest(1, 0)
    assert silent is not None
    assert (silent.coded, silent.picture, silent.basis) == (None, None, 4)
    message, _, basis = nothing(3, basis=5)
    with pytest.raises(DecodeError, match="frame 3 says nothing in 2 bytes"):
        references.add(message, memoryview(b"ab"), basis)


def test_correctors_and_aligners_get_what_is_theirs() -> None:
    references, video = References(), Video()
    assert references.add(*video.picture(0))
    assert references.add(*difference(video, 1, basis=3))
    picture, lacking = (references.newest(frame, 0) for frame in range(2))
    assert picture is not None
    assert lacking is not None
    assert picture.coded is not None
    assert (picture.reference.picture, lacking.reference.picture) == (True, False)
    assert lacking.reference.knee == 0.06
    assert picture.picture is not None
    assert lacking.picture is None
    assert (picture.assumes, lacking.assumes) == (False, True)


def test_the_next_basis_is_the_least_that_waits_and_pictures_assume_none() -> None:
    references, video = References(), Video()
    assert references.next_basis(0, 90) is None
    assert references.add(*difference(video, 5, basis=3))
    assert references.add(*difference(video, 6, basis=4))
    assert references.next_basis(4, 90) == 3
    assert references.next_basis(5, 90) == 4, "the first has been reached"
    assert references.next_basis(6, 90) is None
    assert references.add(*video.picture(7, basis=9))
    assert references.next_basis(6, 90) is None, "a picture assumes nothing"
    assert references.add(*nothing(8, basis=7))
    assert references.next_basis(6, 90) == 7


@pytest.mark.parametrize("frames", [2, 5, 24, 90])
@pytest.mark.parametrize("step", [1, 2])
def test_a_reference_of_a_frame_that_was_skipped_or_came_late_never_holds_anything_back(frames: int, step: int) -> None:
    references = References()
    assert references.add(*nothing(1, basis=4))
    for frame in range(step, 3 * frames, step):  # the frame itself is skipped, or on display
        assert references.next_basis(frame % frames, frames) is None, f"frame {frame}"
    assert references.add(*nothing(0, basis=5))
    for frame in range(3 * frames + 1, 6 * frames, step):
        assert references.next_basis(frame % frames, frames) is None, f"late, at frame {frame}"


def test_in_a_loop_the_next_references_are_of_the_clips_first_frames() -> None:
    references = References()
    assert references.add(*nothing(2, basis=4))
    assert references.next_basis(88, 90) == 4
    assert references.next_basis(3, 90) is None


def test_a_picture_says_what_coding_has_left_in_it() -> None:
    references, video = References(), Video()
    message, unit, basis = video.picture(0)
    assert references.add(replace(message, error=1e-4), unit, basis)
    received = references.newest(0, 0)
    assert received is not None
    assert received.coded is not None
    assert received.reference.error == pytest.approx(1e-4)
