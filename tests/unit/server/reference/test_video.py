"""When the reference video must start anew."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from cags_common.correction.reach import HOLDS
from cags_common.geometry import Intrinsics, Pose
from cags_protocol.wire.messages import ReferenceFrame, ReferenceKind
from cags_server.reference.coder import Coded
from cags_server.reference.video import ReferenceVideo

INTRINSICS = Intrinsics.of_fov(400, 300, 1.0, 0.8)


def send(video: ReferenceVideo, *, idr: bool = False, kind: ReferenceKind = ReferenceKind.PICTURE) -> ReferenceFrame:
    plan = SimpleNamespace(frame=3, basis=7, predicted=SimpleNamespace(pose=Pose.identity()))
    render: Any = SimpleNamespace(plan=plan, intrinsics=INTRINSICS, coded=Coded(kind, b"h264", 0.06, idr))
    message = video.message(render, 9).message
    assert isinstance(message, ReferenceFrame)
    return message


def test_the_first_picture_stands_alone_and_numbers_have_no_gap() -> None:
    video = ReferenceVideo()
    assert video.needs_idr
    assert [send(video).seq for _ in range(3)] == [1, 2, 3]
    assert (send(video).basis, send(video).knee) == (7, 0.06)


def test_a_client_is_told_what_coding_left_in_a_picture() -> None:
    def error(kind: ReferenceKind, after: float | None) -> float:
        return Coded(kind, b"h264", after=after).error

    assert error(ReferenceKind.PICTURE, 2e-5) == 2e-5
    assert error(ReferenceKind.PICTURE, None) == 0
    assert error(ReferenceKind.DIFFERENCE, 2e-5) == 0
    assert error(ReferenceKind.NOTHING, 0.0) == 0


def test_servers_that_say_nothing_of_it_send_large_differences() -> None:
    bare = ReferenceFrame(0, 1, Pose.identity(), INTRINSICS)
    assert bare.reach == Coded(ReferenceKind.DIFFERENCE).reach == HOLDS


def test_what_says_nothing_is_no_picture() -> None:
    video = ReferenceVideo()
    send(video, idr=True)
    silent = send(video, kind=ReferenceKind.NOTHING)
    assert (silent.seq, send(video).seq) == (1, 2)
    video.dropped(silent)
    assert not video.needs_idr


def test_a_picture_that_must_stand_alone_is_owed_until_there_is_one() -> None:
    """References that say nothing come in between: the pictures after them must not need the one that was lost."""
    video = ReferenceVideo()
    send(video, idr=True)
    video.dropped(send(video))
    assert video.urgent
    send(video, kind=ReferenceKind.NOTHING)
    assert video.needs_idr and not video.urgent
    send(video, idr=True)
    assert not video.needs_idr


def test_a_dropped_picture_breaks_the_video_unless_an_idr_has_followed_it() -> None:
    video = ReferenceVideo()
    send(video, idr=True)
    lost = send(video)
    send(video, idr=True)
    video.dropped(lost)
    assert not video.needs_idr
    video.dropped(send(video))
    assert video.needs_idr


@pytest.mark.parametrize(("last_decoded", "needed"), [(1, False), (2, True), (5, True)])
def test_a_request_is_answered_by_an_idr_that_is_under_way(last_decoded: int, needed: bool) -> None:
    video = ReferenceVideo()
    send(video)
    send(video, idr=True)
    video.requested(last_decoded)
    assert video.needs_idr is needed
