"""A client displays what it can draw, evenly: simulated drawers of many speeds."""

import pytest

from cags_client.playback.cadence import Cadence
from cags_protocol.cadence import EVERY_FRAME, LEAST_PERMILLE

PERIOD_US = 1e6 / 30


def play(cadence: Cadence, draw_us: float, seconds: float, *, start_s: float = 0.0) -> list[int]:
    """The frames that a drawer of ``draw_us`` a frame displays; each as soon as it is due and the last one is done."""
    shown, now, after = [], start_s * 1e6, round(start_s * 30)
    while (frame := cadence.next(after, 10**9)) < round((start_s + seconds) * 30):
        now = max(now, due_us(frame))
        frame = cadence.newest_due(round(now), after, 10**9, due_us)
        shown.append(frame)
        after, now = frame + 1, now + draw_us
        cadence.drawn(round(now))
    return shown


def due_us(frame: int) -> int:
    return round(frame * PERIOD_US)


@pytest.mark.parametrize("draw_ms", [1, 20, 33])
def test_a_client_that_keeps_up_displays_every_frame(draw_ms):
    cadence = Cadence()
    assert play(cadence, draw_ms * 1e3, 10) == list(range(300))
    assert cadence.permille == EVERY_FRAME


@pytest.mark.parametrize("draw_ms", [38, 45, 60, 80, 110])
def test_a_slow_client_chooses_little_more_than_it_draws_and_draws_no_fewer(draw_ms):
    cadence = Cadence()
    shown = play(cadence, draw_ms * 1e3, 20)
    possible = PERIOD_US / (draw_ms * 1e3)
    assert possible * 0.97 <= cadence.permille / EVERY_FRAME <= possible * 1.2
    assert len(shown) >= 0.95 * possible * 600


def test_one_stutter_changes_nothing():
    cadence = Cadence()
    play(cadence, 20e3, 3)
    assert cadence.newest_due(3_100_000, 90, 10**9, due_us) == 93, "a tenth of a second lost"
    cadence.drawn(3_120_000)
    play(cadence, 20e3, 3, start_s=3.2)
    assert cadence.permille == EVERY_FRAME


def test_a_client_that_was_slow_displays_every_frame_again():
    cadence = Cadence()
    play(cadence, 60e3, 5)
    assert cadence.permille < 700
    play(cadence, 15e3, 3, start_s=5)
    assert cadence.permille == EVERY_FRAME


def test_a_slow_beginning_is_made_good_in_a_few_seconds():
    cadence = Cadence()
    play(cadence, 150e3, 4)
    assert cadence.permille < 300
    play(cadence, 45e3, 3, start_s=4)
    assert 700 < cadence.permille < 900


def test_it_never_asks_for_less_than_the_protocol_counts_with():
    cadence = Cadence()
    play(cadence, 400e3, 60)
    assert cadence.permille == LEAST_PERMILLE


def test_a_long_hitch_at_the_beginning_costs_half_the_frames_at_most_and_for_a_second():
    cadence = Cadence()
    play(cadence, 400e3, 1.3)
    assert cadence.permille == EVERY_FRAME // 2
    play(cadence, 20e3, 2.5, start_s=1.7)
    assert cadence.permille == EVERY_FRAME


def test_a_jump_is_no_sign_of_slowness():
    cadence = Cadence()
    play(cadence, 20e3, 0.9)
    cadence.restart()
    assert cadence.newest_due(30_000_000, 500, 10**9, due_us) == 900
    assert cadence.permille == EVERY_FRAME


def test_the_last_frame_of_a_clip_is_displayed_in_any_case():
    cadence = Cadence()
    cadence.permille = 250
    assert [cadence.next(frame, 31) for frame in (27, 28, 29, 30)] == [28, 28, 30, 30]
