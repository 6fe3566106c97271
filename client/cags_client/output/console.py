"""The client's live table: what the last second of frames was like."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any

from cags_protocol.wire.encoding import printable

if TYPE_CHECKING:
    from rich.table import Table

WINDOW_US = 1_000_000
"""The table tells of the frames of this last time."""


class PlayConsole:
    """Collects the records of frames (:func:`cags_client.output.report.frame_stats`) and tells of the last."""

    def __init__(self, title: str, frames: int) -> None:
        """``title`` names the clip and ``frames`` is its length."""
        self._title, self._frames = title, frames
        self._recent: deque[dict[str, Any]] = deque(maxlen=240)
        self._shown = self._missed = 0

    def add(self, record: dict[str, Any]) -> None:
        """One more frame was presented."""
        self._recent.append(record)
        self._shown += 1
        self._missed += bool(record["missed"])

    def rows(self) -> list[tuple[str, str]]:
        """Names and values, as they are now."""
        recent = list(self._recent)
        if not recent:
            return [("waiting for", "the first frame")]
        last = recent[-1]
        recent = [r for r in recent if 0 <= last["time_us"] - r["time_us"] < WINDOW_US]
        span_s = max(last["time_us"] - recent[0]["time_us"], 1) / 1e6
        received = sum(r["bytes_tiles"] + r["bytes_reference"] for r in recent[1:])
        rows = [
            ("frame", f"{last['frame'] + 1} of {self._frames}"),
            ("displayed", f"{(len(recent) - 1) / span_s:.1f} frames/s" if len(recent) > 1 else "–"),
            ("shown, missed", f"{self._shown}, {self._missed}"),
            ("goodput", f"{received * 8 / span_s / 1e6:.2f} Mbps" if len(recent) > 1 else "–"),
        ]
        figures = (
            ("latency", "latency_ms", "ms"),
            ("buffer", "buffer_ms", "ms"),
            ("detail", "lod_mean", "LoD"),
            ("prediction error", "prediction_error_deg", "°"),
        )
        rows += [
            (name, f"{mean:.1f} {unit}") for name, key, unit in figures if (mean := _mean(recent, key)) is not None
        ]
        stages = dict.fromkeys(key for r in recent for key in r if key.startswith("ms_"))
        return rows + [(key.removeprefix("ms_"), f"{_mean(recent, key) or 0.0:.1f} ms") for key in stages]

    def table(self) -> Table:
        """The rows as a table."""
        from rich.table import Table
        from rich.text import Text

        # A clip's name comes from the server: neither markup nor a terminal's control characters.
        table = Table(title=Text(printable(self._title)), show_header=False, title_justify="left", min_width=36)
        table.add_column(style="cyan")
        table.add_column(justify="right")
        for name, value in self.rows():
            table.add_row(name, value)
        return table


def _mean(records: list[dict[str, Any]], key: str) -> float | None:
    values = [r[key] for r in records if r.get(key) is not None and r[key] == r[key]]
    return sum(values) / len(values) if values else None
