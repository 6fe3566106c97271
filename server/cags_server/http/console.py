"""The server's live table: one line a client."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from cags_server.records import StreamStats

if TYPE_CHECKING:
    from rich.table import Table

COLUMNS = (
    "client", "frames", "skipped", "stalls", "late references", "estimate", "round trip", "tiles", "references",
    "render", "H.264",
)  # fmt: skip


def session_rows(sessions: Iterable[tuple[str, StreamStats]]) -> list[tuple[str, ...]]:
    """The cells of :data:`COLUMNS` for each client, by name and figures."""
    rows: list[tuple[str, ...]] = []
    for name, stats in sessions:
        costs = stats.careful + stats.light
        references = max(costs.references, 1)
        rows.append(
            (
                name,
                str(stats.frames),
                str(stats.frames_skipped),
                str(stats.stalls),
                str(stats.references_late),
                f"{stats.bandwidth_bps / 1e6:.2f} Mbps",
                f"{stats.rtt_us / 1e3:.0f} ms",
                f"{stats.bytes_tiles / 1e6:.2f} MB",
                f"{stats.bytes_reference / 1e6:.2f} MB",
                f"{costs.render_ns / references / 1e6:.1f} ms",
                f"{costs.encode_ns / references / 1e6:.1f} ms",
            )
        )
    return rows


def sessions_table(title: str, sessions: Iterable[tuple[str, StreamStats]]) -> Table:
    """The clients connected now."""
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for column in COLUMNS:
        table.add_column(column, justify="left" if column == "client" else "right")
    for row in session_rows(sessions):
        table.add_row(*row)
    return table
