"""Frames in time, late ones and stalls, as the operator's page counts them."""

from __future__ import annotations

import pytest

from cags_server.records import StreamStats
from cags_server.session.frame_arrivals import FrameArrivals

PERIOD_US = 100_000


def counted(late_us: list[int]) -> tuple[int, int, int]:
    """In time, late and stalls of frames whose ends come so much after their display."""
    stats = StreamStats()
    arrivals = FrameArrivals(stats)
    for frame, late in enumerate(late_us):
        arrivals.expect(frame, frame * PERIOD_US)
        arrivals.arrived(frame, frame * PERIOD_US + late)
    return stats.frames_in_time, stats.frames_late, stats.stalls


@pytest.mark.parametrize(
    ("late_us", "counts"),
    [
        ([], (0, 0, 0)),
        ([-1, 0, -5], (3, 0, 0)),
        ([-1, 1, 7, 9, -1], (2, 3, 1)),
        ([1, -1, 1, -1, 1], (2, 3, 3)),
    ],
)
def test_a_run_of_late_frames_is_one_stall(late_us: list[int], counts: tuple[int, int, int]) -> None:
    assert counted(late_us) == counts


def test_what_was_on_its_way_when_the_viewer_jumped_is_neither_in_time_nor_late() -> None:
    stats = StreamStats()
    arrivals = FrameArrivals(stats)
    arrivals.expect(3, 0)
    arrivals.forget()
    arrivals.arrived(3, 10**9)
    arrivals.arrived(4, 10**9)  # an end that nobody waits for: of a frame that was skipped
    assert stats == StreamStats()
