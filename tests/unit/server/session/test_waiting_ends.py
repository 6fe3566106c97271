"""Which ends wait, and which are queued again."""

from __future__ import annotations

from cags_protocol.events import Outgoing
from cags_protocol.wire.messages import FrameEnd
from cags_server.session.waiting_ends import WaitingEnds


def end(frame: int, payload: bytes = b"") -> Outgoing:
    return Outgoing(FrameEnd(frame), payload, priority=1)


def test_an_end_waits_from_its_queueing_until_it_leaves() -> None:
    ends = WaitingEnds()
    ends.queued([end(3), end(4)], 1000)
    ends.queued([end(5)], 2000)
    assert ends.has(4, 1000) and not ends.has(4, 999) and not ends.has(6, 9999)
    assert ends.any_until(1000) and not ends.any_until(999)
    assert [ends.left(3), ends.left(4), ends.left(4)] == [1000, 1000, None]
    assert not ends.any_until(1999) and ends.any_until(2000)
    ends.clear()
    assert not ends.any_until(10**12)


def test_the_newest_and_those_that_name_splats_are_queued_again() -> None:
    ends = WaitingEnds()
    for each in (end(1), end(2, b"ids"), end(3)):
        ends.taken_back(each, 1000)
    again = ends.again()
    assert [(each.message.frame, each.urgent) for each in again] == [(2, True), (3, True)]
    assert ends.again() == []
    assert ends.has(3, 1000) and not ends.has(1, 1000), "they wait again"


def test_what_was_taken_back_before_a_control_stays_away() -> None:
    ends = WaitingEnds()
    ends.taken_back(end(1), 1000)
    ends.clear()
    assert ends.again() == []
