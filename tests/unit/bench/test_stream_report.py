"""The plot of a stream over time."""

from __future__ import annotations

import numpy as np
import pytest

from cags_bench.stream_report import StreamTimes, plot_stream
from cags_shaper.trace import open_trace

FPS = 30


def lines(count: int, *first_bytes: int, each: int = 1000) -> list[dict]:
    sizes = [*first_bytes, *[each] * (count - len(first_bytes))]
    begin_us = 7_000_000
    return [
        {
            "time_us": begin_us + round(i * 1e6 / FPS),
            "bytes_tiles": size,
            "bytes_reference": 0,
            "lod_mean": 1.0,
            "half": False,
        }
        for i, size in enumerate(sizes)
    ]


def test_what_came_before_the_first_frame_counts_for_the_whole_wait():
    """It counted for that one frame: 100 Mbps over a link of 3, and nothing else could be seen in the plot."""
    times = StreamTimes.of(lines(90, 500_000), 2.0)
    rates = times.rates_mbps(np.array([500_000.0, *[1000.0] * 89]))
    assert times.edges_s[:2].tolist() == [-2.0, 0.0]
    assert rates[0] == pytest.approx(2.0)
    assert rates[1:].mean() == pytest.approx(8e-6 * 1000 * FPS, rel=0.02)
    assert rates.max() < 2.1


def test_no_byte_is_lost_between_windows():
    frames = lines(400, 9_000, each=700)
    for waited_s in (0.0, 1.3):
        times = StreamTimes.of(frames, waited_s)
        received = np.array([float(frame["bytes_tiles"]) for frame in frames])
        assert (times.rates_mbps(received) * np.diff(times.edges_s)).sum() * 1e6 / 8 == pytest.approx(received.sum())


def test_long_plays_have_longer_windows():
    assert len(StreamTimes.of(lines(FPS * 3600), 1.0).edges_s) == 202


def test_the_link_is_drawn_from_the_connection_on():
    link = open_trace("generated:lte-driving")
    edges_s, mbps = StreamTimes.of(lines(60), 1.5).link_mbps(link)
    assert edges_s[0] == -1.5
    assert mbps[0] == pytest.approx(link.mean_bps(0, round(1e6 * (edges_s[1] - edges_s[0]))) / 1e6)


def test_frames_at_half_resolution_are_shaded_up_to_the_next_whole_one():
    times = StreamTimes.of(lines(6), 0.0)
    at = times.frames_s.tolist()
    assert times.spans([False, True, True, False, True, True]) == [(at[1], at[3]), (at[4], at[5])]
    assert times.spans([False] * 6) == []
    assert times.spans([True] * 6) == [(at[0], at[5])]


@pytest.mark.parametrize("count", [0, 1, 2])
def test_short_plays_are_drawn(tmp_path, count):
    path = tmp_path / "timeline.png"
    plot_stream(lines(count), path, waited_s=0.5, link=open_trace("generated:lte-driving"))
    assert path.exists() == (count > 0)
