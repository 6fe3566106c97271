"""The reference video: pictures in order, what a gap does, and which picture a frame gets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cags_client.store.references import KEPT, Received, References
from cags_common.errors import DecodeError
from cags_common.geometry import Intrinsics, Pose
from cags_common.video.h264 import H264Encoder
from cags_protocol.wire.messages import ReferenceFrame, ReferenceKind

VIEW = Intrinsics.of_fov(64, 48, 1.2, 1.0)
CLIP = 90


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


def shown(references: References, frame: int, max_age: int = 0, frames: int = CLIP) -> Received | None:
    """What a frame on display gets."""
    references.show(frame, frames)
    return references.newest(max_age)


def next_basis(references: References, frame: int, frames: int = CLIP) -> int | None:
    references.show(frame, frames)
    return references.next_basis()


def grey(references: References, frame: int, max_age: int = 0) -> float | None:
    picture = shown(references, frame, max_age)
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
    assert shown(references, 0, 9) is None


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
    assert shown(references, KEPT + 1, KEPT) is None
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
    silent = shown(references, 1, 0)
    assert silent is not None
    assert (silent.coded, silent.picture, silent.basis) == (None, None, 4)
    message, _, basis = nothing(3, basis=5)
    with pytest.raises(DecodeError, match="frame 3 says nothing in 2 bytes"):
        references.add(message, memoryview(b"ab"), basis)


def test_correctors_and_aligners_get_what_is_theirs() -> None:
    references, video = References(), Video()
    assert references.add(*video.picture(0))
    assert references.add(*difference(video, 1, basis=3))
    picture, lacking = (shown(references, frame, 0) for frame in range(2))
    assert picture is not None
    assert lacking is not None
    assert picture.coded is not None
    assert (picture.reference().picture, lacking.reference().picture) == (True, False)
    assert lacking.reference().knee == 0.06
    assert picture.picture is not None
    assert lacking.picture is None
    assert (picture.assumes, lacking.assumes) == (False, True)


def test_the_next_basis_is_the_least_that_waits_and_pictures_assume_none() -> None:
    references, video = References(), Video()
    assert next_basis(references, 0) is None
    assert references.add(*difference(video, 5, basis=3))
    assert references.add(*difference(video, 6, basis=4))
    assert next_basis(references, 4) == 3
    assert next_basis(references, 5) == 4, "the first has been reached"
    assert next_basis(references, 6) is None
    assert references.add(*video.picture(7, basis=9))
    assert next_basis(references, 6) is None, "a picture assumes nothing"
    assert references.add(*nothing(8, basis=7))
    assert next_basis(references, 6) == 7


@pytest.mark.parametrize("frames", [2, 5, 24, 90])
@pytest.mark.parametrize("step", [1, 2])
def test_a_reference_of_a_frame_that_was_skipped_or_came_late_never_holds_anything_back(frames: int, step: int) -> None:
    references = References()
    assert references.add(*nothing(1, basis=4))
    for frame in range(step, 3 * frames, step):  # the frame itself is skipped, or on display
        assert next_basis(references, frame % frames, frames) is None, f"frame {frame}"
    assert references.add(*nothing(0, basis=5))
    for frame in range(3 * frames + 1, 6 * frames, step):
        assert next_basis(references, frame % frames, frames) is None, f"late, at frame {frame}"


def test_in_a_loop_the_next_references_are_of_the_clips_first_frames() -> None:
    references = References()
    assert references.add(*nothing(2, basis=4))
    assert next_basis(references, 88) == 4
    assert next_basis(references, 3) is None


@pytest.mark.parametrize("frames", [12, 90])
def test_a_round_of_a_loop_shows_no_reference_of_the_round_before(frames: int) -> None:
    """They were the last to come, since nothing was lacking any more: the picture fell from 44 to 21 dB there."""
    references = References()
    for frame in range(4):
        assert references.add(*nothing(frame, basis=4))
        assert shown(references, frame, 10, frames) is not None
    for frame in range(4, 3 * frames):
        received = shown(references, frame % frames, 3, frames)
        assert received is None or frame < 7, f"frame {frame}"


@pytest.mark.parametrize("frames", [12, 90])
def test_references_of_the_next_round_come_before_it_begins_and_stay(frames: int) -> None:
    references = References()
    assert references.add(*nothing(1, basis=4))
    assert shown(references, 1, frames=frames) is not None
    assert shown(references, frames - 2, frames=frames) is None
    for frame in (0, 1, 2):
        assert references.add(*nothing(frame, basis=10 + frame))
    for frame in (frames - 1, 0, 1, 2):
        received = shown(references, frame, frames=frames)
        assert (None if received is None else received.basis) == (None if frame == frames - 1 else 10 + frame)


def test_a_reference_that_comes_when_the_next_round_has_begun_is_of_no_use_in_it() -> None:
    references = References()
    assert shown(references, CLIP - 1) is None
    assert shown(references, 1) is None
    assert references.add(*nothing(CLIP - 2, basis=4))
    for frame in range(2, CLIP):
        assert shown(references, frame) is None
        assert references.next_basis() is None


def picture_of_error(error: float) -> Received:
    """A shown picture, in which coding has left ``error``."""
    references = References()
    message, unit, basis = Video().picture(0)
    assert references.add(replace(message, error=error), unit, basis)
    received = shown(references, 0, 0)
    assert received is not None
    return received


def test_a_picture_says_what_coding_has_left_in_it() -> None:
    received = picture_of_error(1e-4)
    assert received.coded is not None
    assert received.reference().error == pytest.approx(1e-4)


def test_a_play_has_a_beginning_and_another_one_after_a_jump() -> None:
    references = References()

    def begins(*frames: int) -> list[bool]:
        found = []
        for frame in frames:
            references.show(frame, 60)
            found.append(references.beginning)
        return found

    assert not references.beginning
    assert begins(3, 14, 15) == [True, True, False]
    references.reset(1)
    assert begins(16) == [False]
    references.reset()
    assert begins(16, 27, 28, 2) == [True, True, False, False]


def test_a_picture_poorer_than_the_splats_is_told_so_and_stays_the_same_while_they_do() -> None:
    received = picture_of_error(1e-4)
    assert received.reference(1e-3) is received.reference()
    doubtful = received.reference(2e-5)
    assert doubtful.error == pytest.approx(4e-4)
    assert received.reference(2.1e-5) is doubtful, "what was made of it is kept"
