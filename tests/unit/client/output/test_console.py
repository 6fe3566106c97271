"""The client's live table tells of the last second, and of nothing where there is nothing."""

from __future__ import annotations

import io
import math

from rich.console import Console

from cags_client.output.console import PlayConsole
from cags_common.runtime.terminal import live_table, watched


def record(frame: int, **more: object) -> dict[str, object]:
    base = {
        "frame": frame,
        "time_us": frame * 50_000,
        "missed": frame == 3,
        "bytes_tiles": 10_000,
        "bytes_reference": 2_500,
    }
    return {**base, "latency_ms": 20.0, "lod_mean": math.nan, "buffer_ms": 100.0, "ms_raster": 8.0, **more}


def test_rows_are_means_over_the_last_second() -> None:
    console = PlayConsole("clip", 90)
    assert console.rows() == [("waiting for", "the first frame")]
    for frame in range(40):
        console.add(record(frame, latency_ms=1e6 if frame < 20 else 30.0, **({"ms_align": 2.0} if frame == 39 else {})))
    rows = dict(console.rows())
    assert rows["frame"] == "40 of 90"
    assert rows["displayed"] == "20.0 frames/s"
    assert rows["shown, missed"] == "40, 1"
    assert rows["goodput"] == "2.00 Mbps"  # 12.5 kB every 50 ms
    assert rows["latency"] == "30.0 ms"
    assert rows["buffer"] == "100.0 ms"
    assert "detail" not in rows  # NaN throughout
    assert (rows["raster"], rows["align"]) == ("8.0 ms", "2.0 ms")


def test_a_loop_s_jump_in_time_does_not_mix_two_passes() -> None:
    console = PlayConsole("clip", 30)
    console.add(record(500, latency_ms=1.0))
    console.add(record(0))
    assert dict(console.rows())["latency"] == "20.0 ms"


def test_the_table_is_drawn_while_the_context_lasts() -> None:
    out = Console(file=io.StringIO(), force_terminal=True, width=80)
    console = PlayConsole("a clip", 3)
    with live_table(console.table, out):
        console.add(record(2))
    assert "a clip" in out.file.getvalue()  # type: ignore[attr-defined]
    assert "3 of 3" in out.file.getvalue()  # type: ignore[attr-defined]


def test_without_a_terminal_nobody_watches() -> None:
    assert not watched(headless=False)
    assert not watched(headless=True)


def test_a_clip_may_have_any_name() -> None:
    console = PlayConsole("walk[/1] \x1b[31m", 3)
    out = io.StringIO()
    Console(file=out, width=80).print(console.table())
    assert "walk[/1] ?[31m" in out.getvalue()
