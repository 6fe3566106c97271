"""The ticks of one client: what is planned next, when, and what is skipped."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_protocol.timeline import Timeline
from cags_protocol.wire.messages import Control
from cags_server.link import LinkState
from cags_server.session.clock import ClientClock
from cags_server.session.schedule import FAIR, JUMP_US, LONGEST_LEAD_US, MOST_PASSED, POOR, Schedule
from cags_server.settings import ServerSettings
from support.links import KnownLink

FPS, FRAMES, AT_US = 50.0, 100, 1_000_000
PERIOD_US = 20_000
SETTINGS = ServerSettings(lead_frames=6)


def playing(
    frames: int = FRAMES,
    frame: int = 0,
    *,
    loop: bool = False,
    settings: ServerSettings = SETTINGS,
    link: LinkState | None = None,
) -> Schedule:
    """A client whose clock is the server's, and which plays from ``frame`` at ``AT_US``."""
    clock = ClientClock()
    made = Schedule(settings, Timeline(FPS, frames), clock, link or KnownLink())
    clock.observe(0, 0)
    made.controlled(Control("play", frame, AT_US, loop=loop), 0)
    return made


def planned(schedule: Schedule) -> int:
    """Plan the next frame, with a reference that is there at once; its media frame."""
    _, frame, _ = schedule.begin_render(0)
    schedule.rendering = False
    return frame


def test_nothing_is_planned_before_the_viewer_says_when_to_play() -> None:
    schedule = Schedule(SETTINGS, Timeline(FPS, FRAMES), ClientClock(), KnownLink())
    assert not schedule.begun
    assert schedule.next_frame is None
    assert schedule.next_due_us(lambda: True) is None


def test_the_lead_is_shorter_while_the_own_picture_is_poor_and_does_not_waver() -> None:
    schedule = playing()
    leads = []
    for error in (0.9 * POOR, 1.1 * POOR, 1.1 * FAIR, 0.9 * FAIR, 1.1 * FAIR):
        schedule.client_lacks(error)
        leads.append(round(schedule.lead_us / PERIOD_US))
    assert leads == [6, 4, 4, 6, 6]
    short = playing(settings=ServerSettings(lead_frames=2))
    short.client_lacks(1.0)
    assert short.lead_us == 2 * PERIOD_US, "never longer"


def test_a_frame_is_due_a_lead_before_its_display() -> None:
    schedule = playing()
    assert schedule.next_due_us(lambda: True) == AT_US - 6 * PERIOD_US
    assert planned(schedule) == 0
    assert schedule.next_due_us(lambda: True) == AT_US - 5 * PERIOD_US


@pytest.mark.parametrize(("permille", "shown"), [(1000, [0, 1, 2, 3]), (500, [0, 2, 4, 6]), (250, [0, 4, 8, 12])])
def test_frames_that_the_client_does_not_display_are_left_out(permille: int, shown: list[int]) -> None:
    schedule = playing()
    schedule.cadence_permille = permille
    assert [planned(schedule) for _ in shown] == shown
    assert schedule.planned_period_us == PERIOD_US * 1000 / permille


def test_frames_that_are_due_while_one_is_rendered_are_covered_by_the_newest() -> None:
    schedule = playing()
    tick, frame, covers = schedule.begin_render(int(2.5 * PERIOD_US))
    assert (tick, frame, covers) == (2, 2, 3)
    assert schedule.is_out(2)
    assert schedule.next_tick == 3


def test_frames_that_became_due_while_the_server_was_busy_are_skipped() -> None:
    schedule = playing()
    due_us = schedule.next_due_us(lambda: True)
    assert due_us is not None
    late_us = int(2.5 * PERIOD_US)
    schedule.begin_render(late_us)
    assert schedule.planned(due_us + late_us) == 2
    assert schedule.planned(due_us + late_us) == 0, "counted once"


def test_frames_that_were_due_before_the_control_came_are_not_skipped() -> None:
    """Over a slow link with its long lead, the hold before a play once counted as 18 frames that were skipped."""
    clock = ClientClock()
    clock.observe(0, 0)
    schedule = Schedule(SETTINGS, Timeline(FPS, FRAMES), clock, KnownLink())
    schedule.controlled(Control("play", 0, AT_US), AT_US)
    tick, _, covers = schedule.begin_render(6 * PERIOD_US)
    assert (tick, covers) == (6, 7)
    assert schedule.planned(AT_US) == 0


def test_frames_that_a_longer_lead_has_made_due_are_not_skipped() -> None:
    link = KnownLink()
    schedule = playing(link=link)
    due_us = schedule.next_due_us(lambda: True)
    assert due_us is not None
    planned(schedule)
    schedule.planned(due_us)
    schedule.pace.observe(1_000_000, 0, 0)
    now_us, earlier_us = due_us + PERIOD_US, schedule.next_due_us(lambda: True)
    assert earlier_us is not None
    schedule.reserve.frames += 20
    assert schedule.begin_render(now_us - earlier_us)[2] > 10
    assert schedule.planned(now_us) == 0, "one became due since the last plan, and is planned"


def test_tiles_of_later_frames_are_not_passed_over_for_a_reference() -> None:
    """With a lead that had grown to 0.6 s the reference of the 27th frame from the next was the first in time; of the
    frames between, the tiles of fifteen were not due for half a second, and were not planned.
    """
    schedule = playing(settings=replace(SETTINGS, tiles_ahead=8))
    planned(schedule)
    schedule.planned(0)
    schedule.reserve.frames = 17
    assert planned(schedule) == 1
    ahead, late_us = schedule.ahead(1), 12 * PERIOD_US
    assert ahead == 18
    tick, _, _ = schedule.begin_render(late_us)
    assert tick == 2 + 17 - 8 + MOST_PASSED
    assert schedule.ahead(tick) == ahead + 1 + MOST_PASSED
    schedule.rendering = False
    assert schedule.begin_render(late_us)[0] == tick + 1 + MOST_PASSED, "the reserve is used up"
    schedule.rendering = False
    tick = schedule.next_tick
    assert schedule.begin_render(30 * PERIOD_US)[0] == tick + 30, "these tiles would be late themselves"


def test_late_frames_that_are_left_out_after_some_were_served_late_are_skipped() -> None:
    """What was due at the plan before was never counted: of 89 displayed frames 41 were planned, and 1 was skipped."""
    schedule = playing()
    due_us = schedule.next_due_us(lambda: True)
    assert due_us is not None
    planned(schedule)
    schedule.planned(due_us)
    late_us = 12 * PERIOD_US  # tiles ahead are in time
    assert schedule.go_blind(late_us) == (1, 1)
    assert schedule.planned(due_us + late_us) == 0
    schedule.reserve.frames += 12
    assert schedule.begin_render(late_us)[0] == 14
    assert schedule.planned(due_us + late_us + 2 * PERIOD_US) == 12


def test_a_server_that_is_slow_to_plan_plans_fewer_frames() -> None:
    """Planned one by one, each later than the one before, frames waited until thirty were given up at once."""
    schedule = playing(settings=replace(SETTINGS, tiles_ahead=8))
    due_us = schedule.next_due_us(lambda: True)
    assert due_us is not None
    planned(schedule)
    schedule.planned(due_us)
    late_us = 5 * PERIOD_US
    assert not schedule.is_slow(late_us, due_us + PERIOD_US), "a longer lead has made them due, and it has just planned"
    assert not schedule.is_slow(PERIOD_US, due_us + late_us)
    assert schedule.is_slow(late_us, due_us + late_us)
    assert schedule.go_blind(late_us, slow=True) == (1 + MOST_PASSED, 1 + MOST_PASSED)
    assert schedule.go_blind(PERIOD_US, slow=True) == (5, 2), "none that is not due"
    assert schedule.go_blind(20 * PERIOD_US, slow=True) == (26, 21), "tiles in turn would be late"


@pytest.mark.parametrize(("permille", "skipped"), [(1000, 7), (500, 3), (250, 1)])
def test_of_frames_that_the_client_does_not_display_none_is_skipped(permille: int, skipped: int) -> None:
    schedule = playing()
    schedule.cadence_permille = permille
    due_us = schedule.next_due_us(lambda: True)
    assert due_us is not None
    planned(schedule)
    schedule.planned(due_us)
    schedule.reserve.frames += 8
    schedule.begin_render(8 * PERIOD_US - schedule.next_tick * PERIOD_US)
    assert schedule.planned(due_us + 8 * PERIOD_US) == skipped


def test_nothing_is_skipped_in_a_pause() -> None:
    schedule = playing()
    schedule.controlled(Control("pause", 0, AT_US), AT_US)
    schedule.begin_render(20 * PERIOD_US)
    assert schedule.planned(AT_US + 20 * PERIOD_US) == 0


def test_a_render_that_is_overdue_is_served_blind_and_then_the_frame_after_it() -> None:
    schedule = playing()
    schedule.begin_render(0)
    due_us = schedule.next_due_us(lambda: True)
    assert due_us is not None
    assert AT_US - 6 * PERIOD_US < due_us < AT_US, "it waits for the render, but not beyond the frame's display"
    assert schedule.serves == 0
    assert schedule.go_blind() == (0, 1)
    assert schedule.overtaken(0)
    assert schedule.serves == 1
    assert schedule.go_blind() == (1, 1)


def test_a_group_of_which_nothing_was_seen_waits_longer_for_its_render() -> None:
    schedule = playing()
    schedule.begin_render(0)
    seen, unseen = (schedule.next_due_us(lambda answer=answer: answer) for answer in (True, False))
    assert seen is not None and unseen is not None
    assert unseen > seen


def test_it_does_not_wait_longer_for_it_than_some_periods_where_renders_are_slow() -> None:
    """It waited for half of the lead: for half a second of a lead of one, with the link idle."""
    schedule = playing(settings=ServerSettings(lead_frames=25))
    schedule.begin_render(0)
    assert schedule.next_due_us(lambda: False) == AT_US - 25 * PERIOD_US + 4 * PERIOD_US


def test_after_a_jump_of_the_clock_one_frame_stands_for_all_before_it() -> None:
    schedule = playing()
    tick, covers = schedule.go_blind(JUMP_US + 10 * PERIOD_US)
    assert (tick, covers) == (60, 61)


def test_a_pause_plans_the_same_frame_again_and_again() -> None:
    schedule = playing(frame=30)
    schedule.controlled(Control("pause", 30, AT_US), 0)
    assert [planned(schedule) for _ in range(3)] == [30, 30, 30]


def test_a_clock_that_was_set_back_in_a_pause_is_followed() -> None:
    clock = ClientClock()
    schedule = Schedule(SETTINGS, Timeline(FPS, FRAMES), clock, KnownLink())
    schedule.controlled(Control("pause", 0, 3_600_000_000), 0)
    clock.observe(0, 0)
    assert (schedule.next_due_us(lambda: True) or 0) > 3_000_000_000
    schedule.follow_clock(0)
    assert (schedule.next_due_us(lambda: True) or 0) < JUMP_US


def test_a_control_makes_void_what_was_planned_before_it() -> None:
    schedule = playing()
    before = schedule.generation
    planned(schedule)
    schedule.controlled(Control("play", 40, AT_US), 0)
    assert schedule.generation == before + 1
    assert schedule.next_frame == 40


def test_a_slow_renderer_makes_the_lead_longer_up_to_a_bound() -> None:
    link = KnownLink()
    schedule = playing(link=link)
    asked = schedule.lead_us
    assert asked == 6 * PERIOD_US
    schedule.pace.observe(200_000, 0, 0)
    without = schedule.lead_us
    assert asked < without
    link.told(rtt_us=50_000)
    assert without < schedule.lead_us < LONGEST_LEAD_US
    link.told(rtt_us=10_000_000)
    assert schedule.lead_us == LONGEST_LEAD_US


def test_a_clip_ends_with_its_last_frame_and_a_loop_begins_again() -> None:
    schedule = playing(frames=3)
    assert [planned(schedule) for _ in range(3)] == [0, 1, 2]
    assert schedule.next_frame is None
    again = playing(frames=3, loop=True)
    assert [planned(again) for _ in range(5)] == [0, 1, 2, 0, 1]


@given(st.lists(st.integers(0, 5 * PERIOD_US), min_size=1, max_size=30), st.sampled_from([1000, 700, 333, 90]))
def test_every_frame_is_covered_once_and_in_order(lates: list[int], permille: int) -> None:
    schedule, covered, newest = playing(frames=10_000), 0, -1
    schedule.cadence_permille = permille
    for late_us in lates:
        tick, _, covers = schedule.begin_render(late_us)
        schedule.rendering = False
        covered += covers
        assert tick > newest
        assert covered == tick + 1
        newest = tick


def test_the_first_frames_are_not_passed_over_and_no_frame_comes_between_later() -> None:
    schedule = playing(settings=replace(SETTINGS, tiles_ahead=4))
    schedule.begin_render(0)
    assert (schedule.ahead(0), schedule.between) == (4, (1, 2, 3))
    schedule.rendering = False
    schedule.begin_render(0)
    assert (schedule.ahead(1), schedule.between) == (5, ())
    schedule.rendering, schedule.cadence_permille = False, 500
    schedule.begin_render(0)
    assert all(tick % 2 == 0 for tick in schedule.between), "of those that are displayed"


@given(st.lists(st.sampled_from([1000, 900, 500, 120]), min_size=1, max_size=20), st.integers(1, 4))
def test_tiles_ahead_never_fall_back(cadences: list[int], ahead: int) -> None:
    schedule = playing(frames=10_000, settings=replace(SETTINGS, tiles_ahead=ahead))
    newest = -1
    for permille in cadences:
        schedule.cadence_permille = permille
        tick, _, _ = schedule.begin_render(0)
        schedule.rendering = False
        assert schedule.ahead(tick) >= max(newest, tick)
        newest = schedule.ahead(tick)
