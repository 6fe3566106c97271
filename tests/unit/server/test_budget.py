"""The account of one client's bytes."""

from __future__ import annotations

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
