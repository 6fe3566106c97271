"""Counters of the server in the text format of Prometheus."""

from __future__ import annotations

import resource
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from cags_server.records import StreamStats


@dataclass
class Totals:
    """Sums over all sessions that have ended; :meth:`with_live` adds those that go on."""

    sessions: int = 0
    frames: int = 0
    frames_late: int = 0
    bytes_tiles: int = 0
    bytes_reference: int = 0
    bytes_other: int = 0
    render_ns: int = 0
    encode_ns: int = 0

    def add(self, stats: StreamStats) -> None:
        """Count a session in."""
        self.sessions += 1
        self.frames += stats.frames
        self.frames_late += stats.frames_skipped + stats.references_late
        self.bytes_tiles += stats.bytes_tiles
        self.bytes_reference += stats.bytes_reference
        self.bytes_other += stats.bytes_other
        self.render_ns += stats.render_ns
        self.encode_ns += stats.encode_ns


def exposition(ended: Totals, live: Iterable[StreamStats]) -> str:
    """The metrics page: one HELP, TYPE and value line (or more) each."""
    running = list(live)
    sums = Totals(**vars(ended))
    for stats in running:
        sums.add(stats)
    count = max(len(running), 1)
    usage = resource.getrusage(resource.RUSAGE_SELF)
    page = _Page()
    page.add("cags_sessions", "gauge", "Clients connected now.", len(running))
    page.add("cags_sessions_total", "counter", "Clients that ever joined.", sums.sessions)
    page.add("cags_frames_total", "counter", "Frames planned.", sums.frames)
    page.add("cags_frames_late_total", "counter", "Frames skipped or rendered too late.", sums.frames_late)
    page.start("cags_sent_bytes_total", "counter", "Payload bytes handed to sessions, by kind.")
    for kind in ("tiles", "reference", "other"):
        page.value(f'cags_sent_bytes_total{{kind="{kind}"}}', getattr(sums, f"bytes_{kind}"))
    for name, total_ns in (("render", sums.render_ns), ("encode", sums.encode_ns)):
        page.start(f"cags_{name}_seconds", "summary", f"Time to {name} reference pictures.")
        page.value(f"cags_{name}_seconds_sum", total_ns / 1e9)
        page.value(f"cags_{name}_seconds_count", sums.frames)
    rate = sum(stats.bandwidth_bps for stats in running) / count
    page.add("cags_bandwidth_estimate_bps", "gauge", "Mean bandwidth estimate of the clients.", rate)
    rtt = sum(stats.rtt_us for stats in running) / count / 1e6
    page.add("cags_rtt_seconds", "gauge", "Mean round trip of the clients.", rtt)
    page.add("process_cpu_seconds_total", "counter", "CPU time used.", usage.ru_utime + usage.ru_stime)
    page.add("process_resident_memory_bytes", "gauge", "Resident memory.", _resident_bytes())
    return page.text()


class _Page:
    def __init__(self) -> None:
        self._lines: list[str] = []

    def start(self, name: str, kind: str, text: str) -> None:
        self._lines += [f"# HELP {name} {text}", f"# TYPE {name} {kind}"]

    def value(self, series: str, value: float) -> None:
        self._lines.append(f"{series} {value:.17g}")

    def add(self, name: str, kind: str, text: str, value: float) -> None:
        self.start(name, kind, text)
        self.value(name, value)

    def text(self) -> str:
        return "\n".join(self._lines) + "\n"


def _resident_bytes() -> int:
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except OSError:  # not Linux: the peak is the best there is
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return pages * resource.getpagesize()
