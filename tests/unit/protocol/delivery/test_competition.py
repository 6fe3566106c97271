"""Whose queue stands on a link, against a link whose queue is a number."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_protocol.delivery.competition import (
    COMPETING_US,
    LONGEST_US,
    LOWEST_US,
    PATH_US,
    STANDING_AGAIN_US,
    STANDING_US,
    TRIAL_US,
    Competition,
)
from cags_protocol.events import Stance

TRIP_US, OWN_US, STEP_US = 40_000, 60_000, 10_000

SEEN_US = STANDING_US + LOWEST_US + STEP_US
"""A queue that comes at once and stays is competed with after so long."""


class Path:
    """Round trips over a link whose queue is set, and may answer to what the session does."""

    def __init__(self, sure_us=0):
        self.sure_us = sure_us
        self.competition, self.now_us, self.stances = Competition(), 0, []
        self.note(0)

    def note(self, queue_us):
        self.now_us += STEP_US
        self.competition.note(self.now_us, TRIP_US + round(queue_us), OWN_US, sure_us=self.sure_us)
        self.stances.append(self.competition.stance)
        return self.competition.stance

    def hold(self, queue_us, time_us):
        return [self.note(queue_us) for _ in range(time_us // STEP_US)]


@given(st.lists(st.integers(0, OWN_US), max_size=600))
def test_a_queue_of_its_own_kind_is_given_way_to(queues):
    path = Path()
    assert all(path.note(queue) is Stance.GIVE_WAY for queue in queues)


@given(st.lists(st.tuples(st.integers(OWN_US + 1, LONGEST_US - 1), st.integers(1, 90)), max_size=40))
def test_a_queue_that_is_gone_now_and_then_is_given_way_to(stretches):
    path = Path()
    for queue, steps in stretches:
        assert set(path.hold(queue, steps * STEP_US)) == {Stance.GIVE_WAY}
        path.note(0)


def test_a_queue_that_others_keep_full_is_competed_with_and_tried_out():
    path = Path()
    assert set(path.hold(200_000, STANDING_US - STEP_US)) == {Stance.GIVE_WAY}
    stances = path.hold(200_000, 25_000_000)
    assert stances.count(Stance.COMPETE) > 0.8 * len(stances)
    assert stances.count(Stance.GIVE_WAY) * STEP_US <= SEEN_US - STANDING_US + 2 * STEP_US
    tried = sum(a is Stance.COMPETE and b is Stance.TRY for a, b in pairwise(stances))
    assert tried == pytest.approx(25_000_000 / (COMPETING_US + TRIAL_US + TRIP_US + 200_000), abs=1.5)


def test_a_path_that_has_become_longer_for_good_is_known_by_then():
    path = Path()
    assert set(path.hold(200_000, PATH_US + SEEN_US)[-50:]) == {Stance.GIVE_WAY}


def test_it_gives_way_again_when_the_others_have_gone():
    """Alone, what is sent less in the trial empties the queue: by 30 % of the time."""
    path, queue_us = Path(), 200_000.0
    path.hold(queue_us, SEEN_US)
    gains = {Stance.GIVE_WAY: -0.05, Stance.TRY: -0.3, Stance.COMPETE: 0.0}
    for _ in range(2 * (COMPETING_US + TRIAL_US) // STEP_US):
        queue_us = max(queue_us + gains[path.competition.stance] * STEP_US, 0.0)
        path.note(queue_us)
    assert path.stances[-300:].count(Stance.GIVE_WAY) == 300
    assert queue_us <= OWN_US


def test_a_rival_that_empties_its_queue_for_a_moment_is_known_when_it_is_back():
    path = Path()
    path.hold(150_000, SEEN_US)
    assert set(path.hold(0, 300_000)) == {Stance.GIVE_WAY}
    assert path.hold(150_000, STANDING_AGAIN_US + LOWEST_US + 2 * STEP_US)[-1] is Stance.COMPETE


def test_a_queue_that_was_its_own_is_believed_to_be_so_for_longer():
    path = Path()
    path.hold(200_000, SEEN_US + COMPETING_US)
    assert path.competition.stance is Stance.TRY
    assert path.hold(80_000, TRIAL_US + TRIP_US + 250_000)[-1] is Stance.GIVE_WAY
    assert set(path.hold(80_000, STANDING_US - 100_000)) == {Stance.GIVE_WAY}


def test_what_waits_for_longer_than_a_picture_is_worth_is_not_competed_with():
    """As a link does that has fallen to a fiftieth, with all that was on its way in front."""
    path = Path()
    path.hold(150_000, SEEN_US)
    assert path.competition.stance is Stance.COMPETE
    path.hold(LONGEST_US + 100_000, 1_000_000)
    assert path.stances[-50:].count(Stance.GIVE_WAY) == 50


def test_single_packets_that_wait_for_lost_ones_change_nothing():
    path = Path()
    path.hold(200_000, SEEN_US)
    before = len(path.stances)
    for _ in range(20):
        path.hold(900_000, 80_000)
        path.hold(200_000, 80_000)
    assert Stance.GIVE_WAY not in path.stances[before:]


def test_a_queue_that_may_be_its_own_is_tried_out_first():
    path = Path(sure_us=250_000)
    stances = path.hold(200_000, SEEN_US + STEP_US)
    assert stances[-1] is Stance.TRY and Stance.COMPETE not in stances
    assert path.hold(90_000, TRIAL_US + TRIP_US + 250_000)[-1] is Stance.GIVE_WAY

    path = Path(sure_us=250_000)
    path.hold(200_000, SEEN_US + STEP_US)
    assert path.hold(200_000, TRIAL_US + TRIP_US + 250_000)[-1] is Stance.COMPETE
