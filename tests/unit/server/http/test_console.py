"""The server's live table: one line a client, means a reference."""

from __future__ import annotations

from cags_server.http.console import COLUMNS, session_rows, sessions_table
from cags_server.records import ReferenceCosts, StreamStats


def test_a_line_a_client_with_means_over_its_frames() -> None:
    busy = StreamStats(frames=10, frames_skipped=2, bandwidth_bps=7.5e6, rtt_us=42_000, bytes_tiles=1_500_000)
    busy.careful, busy.light = ReferenceCosts(9, 118_000_000, 29_000_000), ReferenceCosts(1, 2_000_000, 1_000_000)
    rows = session_rows([("s1", busy), ("s2", StreamStats())])
    assert dict(zip(COLUMNS, rows[0], strict=True)) == {
        "client": "s1", "frames": "10", "skipped": "2", "stalls": "0", "late references": "0", "estimate": "7.50 Mbps",
        "round trip": "42 ms", "tiles": "1.50 MB", "references": "0.00 MB", "render": "12.0 ms", "H.264": "3.0 ms",
    }  # fmt: skip
    assert rows[1][0] == "s2"
    assert sessions_table("here", [("s1", busy)]).row_count == 1
