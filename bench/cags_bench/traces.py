"""Scaled network traces."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path

from cags_bench.bundles import default_cache
from cags_common.bundle import BundleReader
from cags_shaper.trace import Trace, open_trace

RATE_STEP_US = 100_000

PAPER_SPLATS = 170_000
"""Splats of the paper's first frames: 2.0 MB with 66 bits and about 28 bits of position each."""


def scaled_trace(spec: str, share: float, seconds: float, start_s: float = 0.0) -> Path:
    """``seconds`` of a trace from ``start_s`` on, with its rates times ``share``, as a CSV file in the cache."""
    trace, first = open_trace(spec), round(start_s * 1e6)
    steps = math.ceil(seconds * 1e6 / RATE_STEP_US)
    times = [first + i * RATE_STEP_US for i in range(steps)]
    rates = [trace.mean_bps(at, at + RATE_STEP_US) / 1e6 * share for at in times]
    rows = ["time_s,mbps"] + [f"{i * RATE_STEP_US / 1e6:.3f},{rate:.4f}" for i, rate in enumerate(rates)]
    text = "\n".join(rows) + "\n"
    folder = default_cache().with_name("traces")
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{hashlib.sha256(text.encode()).hexdigest()[:16]}.csv"
    if not path.exists():
        path.write_text(text, encoding="utf-8")
    return path


def steepest_fall_s(spec: str, seconds: float) -> float:
    """Where ``seconds`` of a trace begin whose first half has the most rate against the second, by their ratio.

    A clip is seconds long and traces are minutes: their first seconds are often steady, and test nothing.
    """
    trace = open_trace(spec)
    half_us = round(seconds * 5e5)
    starts = range(0, max(trace.duration_us - 2 * half_us, 0) + 1, RATE_STEP_US)
    return max(starts, key=lambda at: _fall(trace, at, half_us)) / 1e6


def _fall(trace: Trace, start_us: int, half_us: int) -> float:
    """Mean rate over ``half_us`` divided by that over the next."""
    before, after = (trace.mean_bps(at, at + half_us) for at in (start_us, start_us + half_us))
    return before / max(after, 1e3)


def splats_of(bundle: Path) -> int:
    """Number of splats in a bundle's first frame."""
    reader = BundleReader.open(str(bundle))
    try:
        return sum(tile.splats for tile in reader.frame(0).tiles)
    finally:
        reader.close()


def link_share(bundle: Path, like_splats: int) -> float:
    """Factor for a link's rates: the scene's number of splats over ``like_splats``; 1 if that is 0."""
    return splats_of(bundle) / like_splats if like_splats else 1.0


def paper_link(bundle: Path, mbps: float) -> str:
    """A steady link that gives the scene as many bits per splat and second as ``mbps`` gives the paper's scenes."""
    return f"generated:steady-{max(mbps * link_share(bundle, PAPER_SPLATS), 0.1):.3f}"
