"""The estimate of a client's clock. One that jumps is followed at once: nothing is made up for, and nobody waits."""

from __future__ import annotations

import pytest

from cags_common.geometry import Pose
from cags_protocol import events as ev
from cags_protocol.wire.messages import PoseSample
from cags_server.records import Ahead, FrameRecord
from cags_server.session.clock import ClientClock
from support.streamer_rig import OFFSET_US, PERIOD_US, Rig

DAYS_11_US = 11 * 86_400 * 1_000_000
SECOND_US = 1_000_000


def turns_until_quiet(rig: Rig, now_us: int) -> int:
    """How often the streamer has something to do at one moment, while no render can be begun."""
    turns = 0
    while (due_us := rig.streamer.next_due_us()) is not None and due_us <= now_us:
        rig.streamer.catch_up(now_us)
        turns += 1
        assert turns < 200, "every missed tick is planned singly"
    return turns


def test_the_clock_offset_is_the_least_delayed_message_of_the_last_ten_seconds() -> None:
    clock = ClientClock()
    for sent, delay in ((0, 30_000), (100_000, 5_000), (200_000, 80_000)):
        clock.observe(sent, sent + 7_000_000 + delay)
    assert clock.offset_us == 7_005_000
    assert clock.to_client(clock.to_server(123)) == 123
    clock.observe(20_000_000, 27_050_000)
    assert clock.offset_us == 7_050_000


def test_a_guess_is_believed_only_until_something_is_known() -> None:
    """Once a Control's display time, which lies ahead of its sending, stuck as the smallest offset for ten seconds."""
    clock = ClientClock()
    clock.guess(250_000, 7_000_000)
    assert clock.offset_us == 6_750_000
    clock.observe(0, 7_010_000)
    clock.guess(300_000, 7_020_000)
    assert clock.offset_us == 7_010_000


@pytest.mark.parametrize("action", ["pause", "play"])
def test_a_clock_that_leaps_ahead_costs_a_frame_or_two(action: str) -> None:
    rig = Rig()
    rig.poses(0, 20_000)
    rig.control(action, 2, 300_000, loop=True)
    rig.step()
    due_us = rig.streamer.next_due_us()
    assert due_us is not None
    job = rig.streamer.begin(due_us)  # a render is out while it happens
    assert job is not None
    now_us = round(due_us + 3 * PERIOD_US)
    rig.streamer.on_event(_poses(now_us - OFFSET_US + DAYS_11_US, now_us), now_us)
    assert turns_until_quiet(rig, now_us) <= 3
    assert rig.streamer.next_due_us() > now_us


def test_a_paused_viewer_whose_clock_is_set_back_is_served_on() -> None:
    rig = Rig()
    at_us = DAYS_11_US
    rig.streamer.on_event(_poses(at_us, at_us + OFFSET_US), at_us + OFFSET_US)
    rig.control("pause", 2, at_us)
    now_us = at_us + OFFSET_US
    for _ in range(60):  # two seconds of a clock that reads eleven days less
        now_us += 33_000
        rig.streamer.on_event(_poses(now_us - OFFSET_US - DAYS_11_US, now_us), now_us)
    due_us = rig.streamer.next_due_us()
    assert due_us is not None
    assert due_us - now_us < 2 * SECOND_US


def test_a_network_that_stalls_is_no_jump() -> None:
    clock = ClientClock()
    clock.observe(0, OFFSET_US)
    for late_us in range(8 * SECOND_US, 0, -SECOND_US // 4):  # what waited comes at one stroke
        clock.observe(9 * SECOND_US - late_us, OFFSET_US + 9 * SECOND_US)
    assert clock.offset_us == OFFSET_US


def test_predictions_that_nothing_will_settle_are_bounded() -> None:
    rig = Rig()
    rig.play()
    for number in range(3000):
        rig.streamer._viewer.expect(_record(number))
    assert len(rig.streamer._viewer._unsettled) <= 512


def _poses(t_us: int, arrival_us: int):
    return ev.PosesReceived((PoseSample(t_us, Pose.identity()),), arrival_us, 1000)


def _record(number: int):
    return FrameRecord(number, 0, Ahead(0, DAYS_11_US), 0, DAYS_11_US, 0, Pose.identity(), (0.1, 0.1), 1)
