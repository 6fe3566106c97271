from hypothesis import given
from hypothesis import strategies as st

from cags_protocol.timeline import Timeline
from cags_protocol.wire.messages import Control
from cags_server.link.pace import MARGIN_US, MAX_CAUTION_US, Pace
from cags_server.session.clock import ClientClock
from cags_server.session.schedule import LONGEST_LEAD_US, Schedule
from cags_server.settings import ServerSettings
from support.links import KnownLink


def test_a_reference_that_was_late_makes_the_lead_longer_by_as_much() -> None:
    settings = ServerSettings()
    schedule = Schedule(settings, Timeline(30.0, 90), ClientClock(), KnownLink())
    schedule.controlled(Control("play", 0, 0), 0)
    asked_us = schedule.lead_us
    schedule.pace.arrived(20_000)
    assert schedule.lead_us == asked_us + 20_000 + MARGIN_US


def test_what_arrives_in_time_takes_the_caution_back() -> None:
    pace = Pace(KnownLink())
    pace.arrived(20_000)
    before = pace.caution_us
    for _ in range(100):
        pace.arrived(-MARGIN_US - 1)
    assert pace.caution_us < 0.01 * before


def test_what_arrives_with_a_margin_changes_nothing() -> None:
    pace = Pace(KnownLink())
    pace.arrived(-MARGIN_US)
    assert pace.caution_us == 0.0


def test_what_is_needed_is_the_work_the_way_through_the_link_and_the_round_trip() -> None:
    link = KnownLink(8e6)
    pace = Pace(link)
    assert pace.needed_us == 0.0, "nothing is known yet"
    pace.observe(20_000, 5_000, 0)
    assert pace.needed_us == 20_000 + 5_000 + MARGIN_US
    link.told(rtt_us=30_000)
    assert pace.needed_us == 20_000 + 5_000 + 30_000 + MARGIN_US


@given(st.lists(st.integers(-10_000_000, 10_000_000), max_size=50))
def test_the_lead_stays_within_its_bounds(late_us: list[int]) -> None:
    settings = ServerSettings()
    schedule = Schedule(settings, Timeline(30.0, 90), ClientClock(), KnownLink())
    schedule.controlled(Control("play", 0, 0), 0)
    asked_us = schedule.lead_us
    for each in late_us:
        schedule.pace.arrived(each)
    assert 0.0 <= schedule.pace.caution_us <= MAX_CAUTION_US
    assert asked_us <= schedule.lead_us <= LONGEST_LEAD_US
