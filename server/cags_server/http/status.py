"""The operator's page: who watches, how they fare, what they are short of, and why the last ones left."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from html import escape
from itertools import islice
from typing import Any

from cags_protocol.events import Closed
from cags_server.http.shortage import shortage
from cags_server.records import RECENT_FRAMES, StreamStats

KEPT_ENDED = 50
"""Ended sessions that the page remembers."""


@dataclass(frozen=True)
class SessionStatus:
    """One session as the operator sees it."""

    session: str
    peer: str
    since: str
    """UTC, ISO 8601."""
    seconds: float
    rate_mbps: float
    """The link's estimate."""
    sent_mb: float
    rtt_ms: float
    level: float
    """Mean level of detail that it holds of what is in view, over the last frames."""
    levels: int
    """Number of levels of the scene."""
    frames: int
    """Planned for it."""
    skipped: int
    """Frames that were due, and not planned because the server was late."""
    in_time: int
    """Frames whose data it had when they were due; it may have skipped some of them."""
    late: int
    """Frames whose data came after they were due, or not at all."""
    stalls: int
    """Runs of late frames."""
    references_late: int
    mirror_mb: float
    """Memory of the server's copy of what the client shows."""
    upgrades: float
    """Tiles raised by a level a frame, of late."""
    short_of: str
    """``processor``, ``renderer``, ``link`` or ``nothing``."""
    shortage: str
    """The same as a sentence with its share."""
    ended: str = ""
    """Why; empty while it goes on."""


def why_ended(ending: Closed | None) -> str:
    """Why a session ended, in words; None if its task was cancelled."""
    if ending is None:
        return "lost"
    return f"{ending.code}: {ending.reason}" if ending.reason else ending.code


class SessionBook:
    """Sessions that go on, and the last ones that ended."""

    def __init__(self) -> None:
        self._began: dict[str, tuple[str, float, float]] = {}  # name -> (peer, wall clock, monotonic clock)
        self._ended: deque[SessionStatus] = deque(maxlen=KEPT_ENDED)

    def began(self, name: str, peer: str) -> None:
        """A client has been let in."""
        self._began[name] = peer, time.time(), time.monotonic()

    def ended(self, name: str, stats: StreamStats, ending: Closed | None) -> SessionStatus | None:
        """A client has left; what is remembered of it."""
        if name not in self._began:
            return None
        status = self._status(name, stats, why_ended(ending))
        del self._began[name]
        self._ended.appendleft(status)
        return status

    def report(self, live: Iterable[tuple[str, StreamStats]]) -> dict[str, Any]:
        """Everything, as JSON has it."""
        now = [asdict(self._status(name, stats)) for name, stats in live if name in self._began]
        return {"sessions": now, "ended": [asdict(each) for each in self._ended]}

    def _status(self, name: str, stats: StreamStats, ended: str = "") -> SessionStatus:
        peer, wall_s, began_s = self._began[name]
        recent, short = list(islice(reversed(stats.records), RECENT_FRAMES)), shortage(stats)
        sent = stats.bytes_tiles + stats.bytes_reference + stats.bytes_other
        return SessionStatus(
            session=name,
            peer=peer,
            since=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(wall_s)),
            seconds=round(time.monotonic() - began_s, 1),
            rate_mbps=round(stats.bandwidth_bps / 1e6, 2),
            sent_mb=round(sent / 1e6, 3),
            rtt_ms=round(stats.rtt_us / 1e3, 1),
            level=round(sum(record.level for record in recent) / max(len(recent), 1), 1),
            levels=stats.levels,
            frames=stats.frames,
            skipped=stats.frames_skipped,
            in_time=stats.frames_in_time,
            late=stats.frames_late,
            stalls=stats.stalls,
            references_late=stats.references_late,
            mirror_mb=round(stats.mirror_bytes / 1e6, 1),
            upgrades=round(sum(record.upgrades for record in recent) / max(len(recent), 1), 1),
            short_of=short.of,
            shortage=str(short),
            ended=ended,
        )


COLUMNS = {
    "session": "session",
    "peer": "from",
    "since": "since (UTC)",
    "seconds": "seconds",
    "rate_mbps": "link, Mbps",
    "sent_mb": "sent, MB",
    "rtt_ms": "round trip, ms",
    "level": "level",
    "frames": "frames planned",
    "skipped": "skipped",
    "in_time": "data in time",
    "late": "data late",
    "stalls": "stalls",
    "references_late": "references late",
    "mirror_mb": "mirror, MB",
    "shortage": "short of",
    "ended": "ended",
}

STYLE = (
    ":root{color-scheme:light dark;font:15px/1.5 system-ui,sans-serif}body{margin:2rem auto;max-width:80rem;"
    "padding:0 1rem}table{border-collapse:collapse;width:100%;display:block;overflow-x:auto}"
    "th,td{padding:.3rem .7rem;text-align:right;border-bottom:1px solid #8884;white-space:nowrap}"
    "th:first-child,td:first-child,td:last-child{text-align:left}p{opacity:.8}"
)


def page(report: dict[str, Any], title: str) -> str:
    """The report as a page that renews itself every two seconds."""
    live, ended = report["sessions"], report["ended"]
    shown = _table(live) if live else "<p>Nobody watches at the moment.</p>"
    before = f"<h2>Left</h2>{_table(ended)}" if ended else ""
    return (
        '<!doctype html><html lang="en"><meta charset="utf-8"><meta http-equiv="refresh" content="2">'
        '<meta name="viewport" content="width=device-width"><title>cags-server</title>'
        f"<style>{STYLE}</style><h1>{escape(title)}</h1><p>{len(live)} watching</p>{shown}{before}</html>"
    )


def _table(rows: list[dict[str, Any]]) -> str:
    names = [name for name in COLUMNS if name != "ended" or any(row["ended"] for row in rows)]
    head = "".join(f"<th>{escape(COLUMNS[name])}</th>" for name in names)
    shown = ({**row, "level": f"{row['level']} of {row['levels']}"} for row in rows)
    lines = ("".join(f"<td>{escape(str(row[name]))}</td>" for name in names) for row in shown)
    return f"<table><tr>{head}</tr>" + "".join(f"<tr>{line}</tr>" for line in lines) + "</table>"
