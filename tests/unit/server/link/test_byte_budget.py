"""The account of one client's bytes."""

from __future__ import annotations

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from cags_common.geometry import Intrinsics, Pose
from cags_protocol.events import Outgoing
from cags_protocol.wire.messages import FrameEnd, ReferenceFrame, TileLayers
from cags_server.link.byte_budget import (
    MAX_BUDGET_TICKS,
    MAX_SAVED_S,
    MESSAGE_OVERHEAD_BYTES,
    MIN_SAVED_BYTES,
    ByteBudget,
)
from cags_server.ratecontrol.priorities import BASE_PRIORITY, ENHANCEMENT_PRIORITY
from cags_server.records import Ahead, FrameRecord
from support.links import KnownLink

PERIOD_US = 100_000.0


def record(ticks: int = 1, reference_bytes: int = 0) -> FrameRecord:
    return FrameRecord(0, 0, Ahead(0, 0), 0, 0, 0, Pose.identity(), (0.0, 0.0), ticks, reference_bytes=reference_bytes)


def tile(size: int) -> Outgoing:
    """A base layer that takes ``size`` bytes of the link."""
    return Outgoing(TileLayers(0, 0, 0, 1, (size,), (0,)), bytes(size - MESSAGE_OVERHEAD_BYTES), BASE_PRIORITY)


def detail(size: int) -> Outgoing:
    return Outgoing(TileLayers(0, 0, 1, 2, (size,), (0,)), bytes(size - MESSAGE_OVERHEAD_BYTES), ENHANCEMENT_PRIORITY)


def reference(size: int) -> Outgoing:
    return Outgoing(
        ReferenceFrame(0, 1, Pose.identity(), Intrinsics.of_fov(40, 30, 0.5, 0.4)), bytes(size - MESSAGE_OVERHEAD_BYTES)
    )


def account(queue_ms: float) -> tuple[ByteBudget, KnownLink]:
    """An account of a link that carries a megabyte a second, or whatever it is told."""
    link = KnownLink(8e6)
    return ByteBudget(link, queue_ms), link


def test_a_frame_earns_what_the_link_carries_in_its_time_less_its_reference() -> None:
    budget, _ = account(0.0)
    assert budget.open(record(reference_bytes=2_000), PERIOD_US, 0) == 98_000


def test_skipped_frames_earn_theirs_too_up_to_a_bound() -> None:
    budget, _ = account(0.0)
    assert budget.open(record(ticks=3), PERIOD_US, 0) == 300_000
    assert budget.open(record(ticks=50), PERIOD_US, 0) == MAX_BUDGET_TICKS * 100_000


def test_what_waits_beyond_the_allowed_queue_is_taken_off_until_it_settles() -> None:
    (budget, _), waiting = account(10.0), tile(50_000)
    budget.planned(waiting, 7)
    assert budget.open(record(), PERIOD_US, 0) == 100_000 - (50_000 - 10_000)
    assert budget.waiting_us(1_007) == 1_000
    budget.settled(waiting)
    assert budget.open(record(), PERIOD_US, 0) == 100_000
    assert budget.waiting_us(1_007) == 0


def test_what_the_client_has_not_decoded_waits_as_well() -> None:
    budget, link = account(10.0)
    link.told(undecoded_bytes=50_000)
    assert budget.open(record(), PERIOD_US, 0) == 100_000 - (50_000 - 10_000)
    link.told(undecoded_bytes=0)
    assert budget.open(record(), PERIOD_US, 0) == 100_000


def test_only_tiles_make_a_waiting_time() -> None:
    budget, _ = account(10.0)
    budget.planned(Outgoing(FrameEnd(0)), 0)
    assert budget.waiting_us(1_000_000) == 0


def test_what_is_left_is_saved_up_to_a_bound() -> None:
    budget, link = account(0.0)
    budget.close(30_000, 0)
    assert budget.open(record(), PERIOD_US, 0) == 130_000
    link.rate_bps = 80e6
    budget.close(10_000_000, 0)
    link.rate_bps = 8e6
    assert budget.open(record(), PERIOD_US, 0) == 100_000 + round(80e6 * MAX_SAVED_S / 8)
    link.rate_bps = 8e3
    budget.close(10_000_000, 0)
    link.rate_bps = 8e6
    assert budget.open(record(), PERIOD_US, 0) == 100_000 + MIN_SAVED_BYTES
    budget.close(-1, 0)
    assert budget.open(record(), PERIOD_US, 0) == 100_000


def test_room_is_what_the_allowed_delay_and_a_frame_hold_less_all_that_waits() -> None:
    (budget, _), waiting = account(100.0), detail(20_000)
    assert budget.room(PERIOD_US, 0) == 200_000
    budget.planned(waiting, 0)
    assert budget.room(PERIOD_US, 0) == 180_000
    budget.settled(waiting)
    budget.planned(tile(200_001), 0)
    assert budget.room(PERIOD_US, 0) == 0


def test_what_arrives_in_time_goes_behind_what_waits() -> None:
    (budget, _), waiting = account(100.0), tile(20_000)
    assert budget.timely(50_000, PERIOD_US, 0, 0) == 50_000
    assert budget.timely(900_000, PERIOD_US, 0, 0) == 200_000, "never more delay than is allowed"
    assert budget.timely(-1, PERIOD_US, 0, 0) == 0
    budget.planned(waiting, 0)
    assert budget.timely(50_000, PERIOD_US, 0, 0) == 30_000
    assert budget.timely(10_000, PERIOD_US, 0, 0) == 0
    budget.settled(waiting)
    assert budget.timely(10_000, PERIOD_US, 0, 0) == 10_000


def test_what_is_on_the_path_has_left_the_queue() -> None:
    """It was counted twice: until its acknowledgement came back, as if it still stood in front of the link."""
    budget, link = account(100.0)
    budget.planned(tile(30_000), 0)
    assert budget.timely(60_000, PERIOD_US, 0, 0) == 30_000
    link.told(in_flight_bytes=20_000, shortest_rtt_us=20_000)
    assert budget.timely(60_000, PERIOD_US, 0, 0) == 40_000 - 10_000, "20 ms go by on the path, and 20 kB are on it"
    assert budget.room(PERIOD_US, 0) == 200_000 - 10_000
    link.told(in_flight_bytes=5_000, shortest_rtt_us=20_000)
    assert budget.timely(60_000, PERIOD_US, 0, 0) == 40_000 - 25_000, "no more than is in flight"


def test_detail_is_overtaken_but_for_what_has_left_the_queue() -> None:
    budget, link = account(100.0)
    budget.planned(detail(30_000), 0)
    assert budget.timely(50_000, PERIOD_US, 0, 0) == 50_000
    link.told(in_flight_bytes=12_000)
    assert budget.timely(50_000, PERIOD_US, 0, 0) == 38_000
    budget.planned(tile(5_000), 0)
    assert budget.timely(50_000, PERIOD_US, 0, 0) == 33_000, "one base layer after the other"


def after_references_of(size: int) -> ByteBudget:
    """Sixty frames have been planned, each with a reference of ``size`` bytes that has arrived."""
    budget, _ = account(1_000.0)
    for _ in range(60):
        each = reference(size)
        budget.planned(each, 0)
        budget.settled(each)
        budget.close(0, 0)
        budget.close(0, 0)  # as for detail of the frame before, or the opening of the next group
        budget.end_frame()
    return budget


def test_references_of_the_frames_planned_meanwhile_go_first() -> None:
    budget = after_references_of(8_000)
    assert budget.timely(300_000, PERIOD_US, 0, 0) == pytest.approx(300_000 - 2 * 8_000, abs=50)
    assert budget.timely(201_000, PERIOD_US, 0, 0) == pytest.approx(200_000 - 8_000, abs=50), "gone before the last"
    assert budget.timely(90_000, PERIOD_US, 0, 0) == 90_000


def test_a_base_layer_goes_if_it_arrives_in_time_or_never_could() -> None:
    budget, _ = account(100.0)
    assert budget.timely(10_000, PERIOD_US, 70_000, 0) == 70_000, "late is better than never"
    budget.planned(tile(6_000), 0)
    assert budget.timely(10_000, PERIOD_US, 70_000, 0) == 70_000
    assert budget.timely(10_000, PERIOD_US, 9_000, 0) == 4_000, "in time with a later frame"
    budget.planned(tile(4_001), 0)
    assert budget.timely(10_000, PERIOD_US, 70_000, 0) == 0, "one after the other"


def test_a_base_layer_that_never_fits_behind_the_references_goes_late() -> None:
    """Else a slow link saved up for it in every frame, and sent nothing at all."""
    budget = after_references_of(60_000)
    assert budget.timely(199_000, PERIOD_US, 120_000, 0) < 150_000
    assert budget.timely(199_000, PERIOD_US, 150_000, 0) == 150_000


MOVES = st.lists(
    st.tuples(
        st.sampled_from(["tile", "detail", "reference", "settle", "close"]), st.integers(MESSAGE_OVERHEAD_BYTES, 60_000)
    ),
    max_size=30,
)


def after(moves: list[tuple[str, int]]) -> tuple[ByteBudget, KnownLink, list[Outgoing]]:
    """An account after ``moves``, its link, and what is not settled."""
    budget, link = account(150.0)
    out: list[Outgoing] = []
    for kind, size in moves:
        if kind == "close":
            budget.close(size, 0)
            budget.end_frame()
        elif kind == "settle":
            if out:
                budget.settled(out.pop(size % len(out)))
        else:
            out.append({"tile": tile, "detail": detail, "reference": reference}[kind](size))
            budget.planned(out[-1], 0)
    return budget, link, out


@example(  # references that are more than the link carries
    moves=[*[("tile", 160)] * 4, ("reference", 4016), ("tile", 160), ("settle", 160), ("close", 160)],
    in_flight=0,
    rtt_us=0,
    spare_us=100_000.0,
    more_us=100_001.0,
    link_bps=64_160.0,
    faster=1.0,
)
@given(
    moves=MOVES,
    in_flight=st.integers(0, 200_000),
    rtt_us=st.integers(0, 400_000),
    spare_us=st.floats(-1e6, 1e6),
    more_us=st.floats(0, 1e6),
    link_bps=st.floats(1e4, 1e9),
    faster=st.floats(1.0, 100.0),
)
def test_bounds_of_what_arrives_in_time(
    moves: list[tuple[str, int]],
    in_flight: int,
    rtt_us: int,
    spare_us: float,
    more_us: float,
    link_bps: float,
    faster: float,
) -> None:
    budget, link, _ = after(moves)
    link.told(in_flight_bytes=in_flight, shortest_rtt_us=rtt_us)
    link.rate_bps = link_bps
    timely, room = budget.timely(spare_us, PERIOD_US, 0, 0), budget.room(PERIOD_US, 0)
    holds = link_bps * (150e3 + PERIOD_US) / 8e6
    assert 0 <= room <= holds
    assert 0 <= timely <= min(holds, link_bps * max(spare_us - rtt_us, 0) / 8e6) + 1
    assert budget.timely(spare_us + more_us, PERIOD_US, 0, 0) >= timely - 1, "more time brings no less"
    for dearest in (1_000, 50_000, 1_000_000):
        assert budget.timely(spare_us, PERIOD_US, dearest, 0) in (timely, dearest)
    link.rate_bps = link_bps * faster
    assert budget.timely(spare_us, PERIOD_US, 0, 0) >= timely - 1, "a faster link brings no less"
    assert budget.room(PERIOD_US, 0) >= room - 1


@given(moves=MOVES, link_bps=st.floats(1e4, 1e9))
def test_an_account_in_which_all_is_settled_is_as_new(moves: list[tuple[str, int]], link_bps: float) -> None:
    budget, link, out = after([move for move in moves if move[0] != "reference"])
    for each in out:
        budget.settled(each)
    new, link.rate_bps = ByteBudget(link, queue_ms=150.0), link_bps
    assert budget.timely(1e5, PERIOD_US, 0, 0) == new.timely(1e5, PERIOD_US, 0, 0)
    assert budget.room(PERIOD_US, 0) == new.room(PERIOD_US, 0)
    assert budget.waiting_us(10**6) == 0


def test_over_an_idle_link_one_message_may_take_all_that_was_earned() -> None:
    budget, _ = account(10.0)
    budget.planned(tile(49_000), 0)
    assert budget.alone(128_000, PERIOD_US, 0) == 128_000, "half a frame's carry is what ends and references take"
    budget.planned(tile(2_000), 0)
    assert budget.alone(128_000, PERIOD_US, 0) == 0
