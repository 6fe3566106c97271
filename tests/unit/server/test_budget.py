"""The account of one client's bytes."""

from __future__ import annotations

import pytest

from cags_common.geometry import Pose
from cags_protocol.events import Outgoing
from cags_protocol.messages import FrameEnd, TileLayers
from cags_server.budget import MAX_BUDGET_TICKS, MAX_SAVED_S, MIN_SAVED_BYTES, ByteBudget
from cags_server.records import FrameRecord

PERIOD_US = 100_000.0


def record(ticks: int = 1, reference_bytes: int = 0) -> FrameRecord:
    return FrameRecord(0, 0, 0, 0, 0, Pose.identity(), (0.0, 0.0), ticks, reference_bytes=reference_bytes)


def tile(size: int) -> Outgoing:
    return Outgoing(TileLayers(0, 0, 0, 1, (size,), (0,)), bytes(size))


def test_a_frame_earns_what_the_link_carries_in_its_time_less_its_reference() -> None:
    budget = ByteBudget(queue_ms=0.0)
    assert budget.open(record(reference_bytes=2_000), 8e6, PERIOD_US) == 98_000


def test_skipped_frames_earn_theirs_too_up_to_a_bound() -> None:
    budget = ByteBudget(queue_ms=0.0)
    assert budget.open(record(ticks=3), 8e6, PERIOD_US) == 300_000
    assert budget.open(record(ticks=50), 8e6, PERIOD_US) == MAX_BUDGET_TICKS * 100_000


def test_what_waits_beyond_the_allowed_queue_is_taken_off_until_it_settles() -> None:
    budget, waiting = ByteBudget(queue_ms=10.0), tile(50_000)
    budget.planned(waiting, 7)
    assert budget.open(record(), 8e6, PERIOD_US) == 100_000 - (50_000 - 10_000)
    assert budget.waiting_us(1_007) == 1_000
    budget.settled(waiting)
    assert budget.open(record(), 8e6, PERIOD_US) == 100_000
    assert budget.waiting_us(1_007) == 0


def test_what_the_client_has_not_decoded_waits_as_well() -> None:
    budget = ByteBudget(queue_ms=10.0)
    budget.undecoded_bytes = 50_000
    assert budget.open(record(), 8e6, PERIOD_US) == 100_000 - (50_000 - 10_000)
    budget.undecoded_bytes = 0
    assert budget.open(record(), 8e6, PERIOD_US) == 100_000


def test_only_tiles_make_a_waiting_time() -> None:
    budget = ByteBudget(queue_ms=10.0)
    budget.planned(Outgoing(FrameEnd(0)), 0)
    assert budget.waiting_us(1_000_000) == 0


def test_what_is_left_is_saved_up_to_a_bound() -> None:
    budget = ByteBudget(queue_ms=0.0)
    budget.close(30_000, 8e6)
    assert budget.open(record(), 8e6, PERIOD_US) == 130_000
    budget.close(10_000_000, 80e6)
    assert budget.open(record(), 8e6, PERIOD_US) == 100_000 + round(80e6 * MAX_SAVED_S / 8)
    budget.close(10_000_000, 8e3)
    assert budget.open(record(), 8e6, PERIOD_US) == 100_000 + MIN_SAVED_BYTES
    budget.close(-1, 8e6)
    assert budget.open(record(), 8e6, PERIOD_US) == 100_000


def test_room_is_what_still_arrives_in_time_behind_what_is_on_its_way() -> None:
    budget, waiting = ByteBudget(queue_ms=100.0), tile(20_000)
    assert budget.room(50_000, PERIOD_US, 8e6, 0) == 50_000
    assert budget.room(900_000, PERIOD_US, 8e6, 0) == 200_000, "never more delay than is allowed"
    assert budget.room(-1, PERIOD_US, 8e6, 0) == 0
    budget.planned(waiting, 0)
    assert budget.room(50_000, PERIOD_US, 8e6, 0) == 30_000
    assert budget.room(10_000, PERIOD_US, 8e6, 0) == 0
    budget.settled(waiting)
    assert budget.room(10_000, PERIOD_US, 8e6, 0) == 10_000


def test_a_base_layer_goes_if_it_arrives_in_time_or_never_could() -> None:
    budget = ByteBudget(queue_ms=100.0)
    assert budget.room(10_000, PERIOD_US, 8e6, 70_000) == 70_000, "late is better than never"
    budget.planned(tile(6_000), 0)
    assert budget.room(10_000, PERIOD_US, 8e6, 70_000) == 70_000
    assert budget.room(10_000, PERIOD_US, 8e6, 9_000) == 4_000, "in time with a later frame"
    budget.planned(tile(4_001), 0)
    assert budget.room(10_000, PERIOD_US, 8e6, 70_000) == 0, "one after the other"


def test_detail_leaves_room_for_the_base_layers_that_will_overtake_it() -> None:
    budget = ByteBudget(queue_ms=1_000.0)
    for _ in range(60):
        base = tile(8_000)
        budget.planned(base, 0)
        budget.settled(base)
        budget.close(0, 8e6)
    assert budget.room(300_000, PERIOD_US, 8e6, 0) == pytest.approx(300_000 - 2 * 8_000, abs=50)
    for _ in range(60):
        budget.close(0, 8e6)
    assert budget.room(300_000, PERIOD_US, 8e6, 0) == pytest.approx(300_000, abs=50), "a scene that stands still"
