"""What a viewer notices beside the quality of single pictures: uneven frames, freezes, jumps of quality.

Times are those at which pictures were ready to be displayed, so that a frame that was drawn late counts as late.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cags_common.geometry import F64

EVEN_MS = 50.0
"""Gaps between pictures up to this are even: one and a half frames at 30 frames a second."""

FREEZE_FACTOR, FREEZE_EXTRA_MS = 3.0, 150.0
"""A gap of at least this many mean gaps, and this much longer than one, is a freeze (W3C webrtc-stats)."""

STEPS_OF = ("psnr_restored_db", "psnr_covered_restored_db")
"""Figures whose steps between consecutive pictures are reported."""

LEVEL_STEP = 0.5
"""Smallest change of the mean quality level in view from one picture to the next that counts as a switch."""


def steadiness(records: Sequence[Mapping[str, Any]], started_us: int | None = None) -> dict[str, float]:
    """Figures of one play. ``records`` has one entry per displayed media frame, in order (:func:`.report.frame_stats`).
    ``started_us`` is when the first frame was due: frames skipped before the first picture are a gap, too. The last one
    of a play is never skipped.

    Frames a second, share of even gaps, 95th percentile of gaps [ms], number and duration of freezes [ms], switches of
    the quality level and those of them that are falls, and for each measured PSNR its 5th percentile and the 95th
    percentile of its steps [dB]. Empty where there is no gap.
    """
    shown_ms = [record["time_us"] / 1e3 + record["latency_ms"] for record in records]
    if records and started_us is not None and records[0]["time_us"] > started_us:
        shown_ms.insert(0, started_us / 1e3)  # the held first frame is on the display until then
    if len(shown_ms) < 2:
        return {}
    gaps_ms = np.diff(shown_ms)
    mean_ms = float(gaps_ms.mean())
    frozen = gaps_ms >= max(FREEZE_FACTOR * mean_ms, mean_ms + FREEZE_EXTRA_MS)
    levels = _series(records, "lod_mean")
    out = {
        "frames_per_s": 1e3 / mean_ms if mean_ms > 0 else 0.0,
        "even_share": float((gaps_ms <= EVEN_MS).mean()),
        "gap_p95_ms": float(np.percentile(gaps_ms, 95)),
        "freezes": int(frozen.sum()),
        "frozen_ms": float(gaps_ms[frozen].sum()),
        "level_switches": int((np.abs(np.diff(levels)) > LEVEL_STEP).sum()),
        "level_falls": int((np.diff(levels) < -LEVEL_STEP).sum()),
    }
    for name in STEPS_OF:
        values = _series(records, name)
        known, steps = values[np.isfinite(values)], np.abs(np.diff(values))
        steps = steps[np.isfinite(steps)]  # none if only every n-th picture was measured
        stem = name.removesuffix("_db")
        if len(known):
            out[f"{stem}_p5_db"] = float(np.percentile(known, 5))
        if len(steps):
            out[f"{stem}_step_p95_db"] = float(np.percentile(steps, 95))
    return out


def _series(records: Sequence[Mapping[str, Any]], key: str) -> F64:
    """One figure over records; NaN where one has none."""
    return np.array([np.nan if record.get(key) is None else float(record[key]) for record in records])
