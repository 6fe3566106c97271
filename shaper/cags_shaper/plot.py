"""A picture of a shaper's log: what the link allowed, what it delivered, how long its queue was."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from cags_common.errors import TraceError
from cags_shaper.log import INTERVAL_US

DIRECTIONS = "down", "up"
WAY_OUT = "give a file written by cags-shaper --log"


def plot_log(path: Path) -> Path:
    """Draw ``path`` into a PNG beside it, and return that. Raises :class:`TraceError` for anything else."""
    rows = read_log(path)
    out = path.with_suffix(".png")
    if out == path:
        raise TraceError(f"{path}: its picture would take its place; give the log another name")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 6), layout="constrained")
    FigureCanvasAgg(figure)
    rate, queue = figure.subplots(2, 1, sharex=True)
    for direction, colour in zip(DIRECTIONS, ("tab:blue", "tab:orange"), strict=True):
        here = [row for row in rows if row["direction"] == direction]
        seconds = [row["t_us"] / 1e6 for row in here]
        spans_us = [b["t_us"] - a["t_us"] for a, b in zip([{"t_us": 0}, *here], here, strict=False)]
        capacities = [math.nan if row["capacity_bytes"] is None else row["capacity_bytes"] for row in here]
        if direction == "down" and not all(map(math.isnan, capacities)):  # a live cap may come and go
            allowed = [size * 8 / max(us, 1) for size, us in zip(capacities, spans_us, strict=True)]
            rate.fill_between(seconds, allowed, step="pre", color="0.85", label="capacity, down")
        delivered = [row["delivered_bytes"] * 8 / max(us, 1) for row, us in zip(here, spans_us, strict=True)]
        rate.step(seconds, delivered, color=colour, label=f"delivered, {direction}")
        queue.step(seconds, [row["queued_bytes"] / 1024 for row in here], color=colour, label=direction)
    rate.set_ylabel("Mbps")
    queue.set_ylabel("queue, KiB")
    queue.set_xlabel("time, s")
    rate.legend(loc="upper right")
    queue.legend(loc="upper right")
    figure.savefig(out, dpi=110)
    return out


def read_log(path: Path) -> list[dict[str, Any]]:
    """The samples of a log; a last line cut short is left out. Raises :class:`TraceError`."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    except OSError as error:
        raise TraceError(f"{path}: cannot be read ({error.strerror}); {WAY_OUT}") from error
    except UnicodeDecodeError as error:
        raise TraceError(f"{path}: is no log of cags-shaper (byte {error.start} is not UTF-8); {WAY_OUT}") from error
    try:
        header, *rows = [json.loads(line) for line in lines if line.endswith("\n")]
        known = header["log"] == "cags-shaper" and header["interval_us"] == INTERVAL_US
    except (ValueError, KeyError, TypeError) as error:
        empty = "" if lines else " (it is empty)"
        raise TraceError(f"{path}: is no log of cags-shaper{empty}; {WAY_OUT}") from error
    if not known or not rows:
        raise TraceError(f"{path}: is no log of this version of cags-shaper, or holds no samples; {WAY_OUT}")
    for number, row in enumerate(rows, start=2):
        if not _is_sample(row):
            raise TraceError(f"{path}, line {number}: is no sample of cags-shaper; {WAY_OUT}")
    return rows


def _is_sample(row: Any) -> bool:
    """Whether ``row`` has what is drawn of a sample."""
    if not isinstance(row, dict) or row.get("direction") not in DIRECTIONS:
        return False
    capacity = row.get("capacity_bytes", "")
    counts = [row.get(name) for name in ("t_us", "delivered_bytes", "queued_bytes")]
    return all(isinstance(value, int | float) for value in (*counts, 0 if capacity is None else capacity))
