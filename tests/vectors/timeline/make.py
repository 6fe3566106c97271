"""Write timelines and what they come to: ``python tests/vectors/timeline/make.py FILE``. Both players read it."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path

from cags_protocol.timeline import Timeline

TIMELINES = {
    "thirty frames a second": Timeline(30.0, 300, 0, 1_500_000, 1.0, True),
    "a rate of broadcasting, slowly": Timeline(24000 / 1001, 240, 17, 987_654_321, 0.37, True),
    "many frames a second, fast": Timeline(1000.0, 100_000, 5, 3, 16.0, True),
    "a loop from the middle": Timeline(25.0, 10, 8, 40_000, 2.0, True, True),
    "a loop of one frame": Timeline(60.0, 1, 0, 0, 1.0, True, True),
    "a frame that is held": Timeline(30.0, 50, 12, 70, 1.0),
}
TICKS = (-3, 0, 1, 2, 3, 10, 11, 99, 240, 12_345)


def vector(name: str, timeline: Timeline) -> dict[str, object]:
    """Ticks with when and what they display, and the first tick from a microsecond before, at and after each."""
    ticks = [[tick, timeline.display_us(tick), timeline.media_frame(tick)] for tick in TICKS]
    times = [timeline.display_us(tick) + off for tick in TICKS for off in (-1, 0, 1)]
    first = [[time, timeline.first_tick(time)] for time in times]
    return {"name": name, "timeline": dataclasses.asdict(timeline), "ticks": ticks, "first_ticks": first}


if __name__ == "__main__":
    made = [vector(name, timeline) for name, timeline in TIMELINES.items()]
    Path(sys.argv[1]).write_text("[\n" + ",\n".join(json.dumps(each) for each in made) + "\n]\n")
