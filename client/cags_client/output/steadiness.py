"""What a viewer notices beside the quality of single pictures: uneven frames, freezes, jumps of quality.

Times are those at which pictures were ready to be displayed, so that a frame that was drawn late counts as late.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cags_common.geometry import F64

EVEN_MS = 50.0
"""A picture that follows the one before within this time follows evenly: one and a half frames at 30 a second."""

FREEZE_FACTOR, FREEZE_EXTRA_MS = 3.0, 150.0
"""A gap is a freeze where it is at least so many times the mean gap and so much longer (W3C webrtc-stats,
``freezeCount``).
"""

STEPS_OF = ("psnr_restored_db", "psnr_covered_restored_db")
"""Figures whose steps from picture to picture are told."""

LEVEL_STEP = 0.5
"""The mean quality level of what is in view falls where it falls by more than this."""


def steadiness(records: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Figures of a play's records, one a displayed media frame (:func:`.report.frame_stats`), in order.

    Frames a second, share of even gaps, the gap that 95 % do not exceed [ms], freezes and their time [ms], falls of the
    quality level, and of each PSNR that was measured the value that 95 % exceed and the step that 95 % do not [dB].
    Empty for fewer than two frames.
    """
    if len(records) < 2:
        return {}
    shown_ms = np.array([record["time_us"] / 1e3 + record["latency_ms"] for record in records])
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
        "level_falls": int((np.diff(levels) < -LEVEL_STEP).sum()),
    }
    for name in STEPS_OF:
        values = _series(records, name)
        known, steps = values[np.isfinite(values)], np.abs(np.diff(values))
        steps = steps[np.isfinite(steps)]  # none where only every so many-th picture was measured
        stem = name.removesuffix("_db")
        if len(known):
            out[f"{stem}_p5_db"] = float(np.percentile(known, 5))
        if len(steps):
            out[f"{stem}_step_p95_db"] = float(np.percentile(steps, 95))
    return out


def _series(records: Sequence[Mapping[str, Any]], key: str) -> F64:
    """One figure over records; NaN where one has none."""
    return np.array([np.nan if record.get(key) is None else float(record[key]) for record in records])
