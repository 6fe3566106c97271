"""Plot of a session's event trace: rate, round trip, bytes in flight against credit, queue, drops."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from cags_common.errors import TraceError

BIN_US = 100_000


def plot_session(path: Path) -> Path:
    """Plot the trace ``path`` into a PNG beside it, and return the PNG's path. Raises :class:`TraceError`."""
    records = read_session(path)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    start_us = records[0]["t_us"]
    by_event: dict[str, list[dict[str, Any]]] = {}
    for record in records:
        by_event.setdefault(record["event"], []).append(record)
    figure = Figure(figsize=(11, 8), layout="constrained")
    FigureCanvasAgg(figure)
    rate, rtt, flight = figure.subplots(3, 1, sharex=True)
    acked, sent = by_event.get("acked", []), by_event.get("sent", [])

    def seconds(rows: list[dict[str, Any]]) -> list[float]:
        return [(row["t_us"] - start_us) / 1e6 for row in rows]

    times, mbps = binned_mbps(acked, start_us)
    rate.step(times, mbps, label="delivered")
    rate.set_ylabel("Mbps")
    rtt.plot(seconds(acked), [row["rtt_us"] / 1e3 for row in acked], ".", markersize=2, label="round trip")
    rtt.set_ylabel("ms")
    flight.plot(seconds(sent), [row["in_flight_bytes"] / 1024 for row in sent], label="in flight")
    flight.plot(seconds(sent), [row["window_bytes"] / 1024 for row in sent], label="credit")
    flight.plot(seconds(acked), [row["queued_bytes"] / 1024 for row in acked], label="queued")
    flight.plot(seconds(by_event.get("dropped", [])), [0] * len(by_event.get("dropped", [])), "rx", label="dropped")
    flight.set_ylabel("KiB")
    flight.set_xlabel("time, s")
    for axes in (rate, rtt, flight):
        axes.legend(loc="upper right")
    out = path.with_suffix(".png")
    figure.savefig(out, dpi=110)
    return out


def binned_mbps(acked: list[dict[str, Any]], start_us: int) -> tuple[list[float], list[float]]:
    """Times (s) and rates (Mbps) of acknowledged bytes in bins of :data:`BIN_US`."""
    bins: dict[int, int] = {}
    for row in acked:
        index = (row["t_us"] - start_us) // BIN_US
        bins[index] = bins.get(index, 0) + row["bytes"]
    count = max(bins, default=-1) + 1
    return [i * BIN_US / 1e6 for i in range(count)], [bins.get(i, 0) * 8 / BIN_US for i in range(count)]


_HINT = "cags-server --event-traces FOLDER writes them"


def read_session(path: Path) -> list[dict[str, Any]]:
    """Records of a trace without its header. Raises :class:`TraceError`."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
        header, *records = [json.loads(line) for line in lines if line.endswith("\n")]
        known = header["trace"] == "cags-session"
    except OSError as error:
        raise TraceError(f"{path}: cannot be read ({error.strerror}); {_HINT}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise TraceError(f"{path}: is not an event trace of a session; {_HINT}") from error
    if not known or not records:
        raise TraceError(f"{path}: is not an event trace of a session, or has no events; {_HINT}")
    return records
