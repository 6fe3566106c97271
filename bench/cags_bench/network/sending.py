"""Sending alone, over every trace: utilisation, latency, waste, and the estimate compared with the true link."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from cags_bench.network.load import REFERENCE_BYTES, Arrivals, run_load
from cags_server.link import MeasuredLink
from cags_shaper.generate import MODELS, STEADY_MBPS
from cags_shaper.link import LinkSettings
from cags_shaper.trace import Trace, open_trace, trace_of_rates

SHIPPED = (*(f"generated:steady-{rate}" for rate in STEADY_MBPS), *(f"generated:{name}" for name in MODELS))
INCIDENTS = {"5g-mmwave": 7, "lte-driving": 10, "step": 12, "sawtooth": 17, "blackout": 8}
"""Start of a seven-second clip within a trace, in seconds, so that it contains the fall or the outage."""

CLIPS = tuple(
    f"{spec}:start_s={INCIDENTS[name]}" if (name := spec.removeprefix("generated:")) in INCIDENTS else spec
    for spec in SHIPPED
)
"""The shipped traces, each starting shortly before its fall or outage."""

SLOW = ("generated:steady-2", "generated:steady-10")
"""Slow links on which the first picture must come soon."""

SETTLE_US = 2_000_000
"""Results exclude the first two seconds of a session, and the two seconds after a fall."""

AHEAD_US = 300_000
"""Estimates are compared with the link's mean capacity over this time ahead."""

FALL_US = 8_000_000


def sending_lines(duration_us: int, delay_us: int) -> Iterator[dict[str, Any]]:
    """One line per shipped trace, and one for a fall from 20 to 1.5 Mbps."""
    for spec in SHIPPED:
        trace = open_trace(spec)
        log = run_load(trace, MeasuredLink(), duration_us, LinkSettings(delay_us=delay_us))
        yield {"case": "sending", "trace": spec, **figures(log, trace, SETTLE_US, duration_us)}
    fall = trace_of_rates("fall", [0.0, FALL_US / 1e6], [20.0, 1.5], 60.0)
    log = run_load(fall, MeasuredLink(), 20_000_000, LinkSettings(delay_us=delay_us))
    yield {"case": "sending", "trace": "20 to 1.5 Mbps", **figures(log, fall, FALL_US + SETTLE_US, 20_000_000)}


def figures(log: Arrivals, trace: Trace, start_us: int, end_us: int) -> dict[str, Any]:
    """Results of a session between two times."""
    tiles = [(latency, size) for arrived, latency, size in log.tiles if start_us < arrived <= end_us]
    references = [latency for arrived, latency in log.references if start_us < arrived <= end_us]
    received = sum(size for _, size in tiles) + REFERENCE_BYTES * len(references)
    latencies = [latency for latency, _ in tiles] + references
    return {
        "capacity_mbps": trace.mean_bps(start_us, end_us) / 1e6,
        "utilisation": received * 8e6 / (end_us - start_us) / trace.mean_bps(start_us, end_us),
        "latency_ms": percentile(latencies, 50),
        "latency_p95_ms": percentile(latencies, 95),
        "reference_latency_ms": percentile(references, 50),
        "reference_latency_p95_ms": percentile(references, 95),
        "estimate_error": estimate_error(log.estimates, trace, start_us, end_us),
        "wasted_share": log.wasted_bytes / max(log.sent_bytes, 1),
        "dropped": log.dropped,
    }


def estimate_error(estimates: list[tuple[int, float]], trace: Trace, start_us: int, end_us: int) -> float:
    """Median of |estimate - capacity| / capacity over times with capacity; estimates are (time, bps)."""
    errors = []
    for now_us, estimate_bps in estimates:
        if start_us < now_us <= end_us:
            true_bps = trace.mean_bps(now_us, now_us + AHEAD_US)
            if true_bps > 0:
                errors.append(abs(estimate_bps - true_bps) / true_bps)
    return float(np.median(errors)) if errors else float("nan")


def percentile(values_us: list[int], share: float) -> float:
    """Percentile of times, in milliseconds."""
    return float(np.percentile(values_us, share)) / 1e3 if values_us else float("nan")
