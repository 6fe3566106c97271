"""Which media frame is displayed when."""

import json
from pathlib import Path

import pytest

from cags_protocol.timeline import Timeline
from cags_protocol.wire.messages import Control

VECTORS = json.loads((Path(__file__).parents[2] / "vectors" / "timeline" / "v1.json").read_text())


def test_frames_follow_the_rate() -> None:
    timeline = Timeline(30.0, 100).controlled(Control("play", 10, 1_000_000, 2.0))
    assert timeline.playing
    assert timeline.display_us(3) == 1_050_000
    assert timeline.media_frame(3) == 13
    assert timeline.media_frame(90) is None


def test_a_loop_starts_again_after_the_last_frame() -> None:
    timeline = Timeline(30.0, 10).controlled(Control("play", 8, 0, loop=True))
    assert [timeline.media_frame(t) for t in range(4)] == [8, 9, 0, 1]


def test_a_seek_beyond_the_end_goes_to_the_last_frame_and_keeps_playing() -> None:
    playing = Timeline(30.0, 10).controlled(Control("play", 0, 0))
    sought = playing.controlled(Control("seek", 99, 5))
    assert (sought.frame, sought.playing) == (9, True)
    assert not sought.controlled(Control("pause", 9, 6)).playing


def test_a_frame_that_is_held_is_displayed_at_every_tick() -> None:
    held = Timeline(30.0, 10).controlled(Control("pause", 4, 0))
    assert [held.media_frame(tick) for tick in (0, 5, 50)] == [4, 4, 4]


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector["name"])
def test_recorded_timelines(vector: dict) -> None:
    timeline = Timeline(**vector["timeline"])
    for tick, at_us, frame in vector["ticks"]:
        assert (timeline.display_us(tick), timeline.media_frame(tick)) == (at_us, frame)
    for from_us, tick in vector["first_ticks"]:
        assert timeline.first_tick(from_us) == tick
