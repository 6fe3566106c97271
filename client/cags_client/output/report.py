"""The report of a play: a line a frame and a summary, as JSON."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

import cv2
import numpy as np

from cags_client.frame.presented import PresentedFrame
from cags_client.output.score import averages
from cags_client.output.steadiness import steadiness
from cags_client.playback.jobs import Present
from cags_client.stats import PlayStats
from cags_common.geometry import F32, angle_between
from cags_common.passes import Pass, tally

STAGE = "ms_"
"""Prefix of a record's stage times."""


def frame_stats(presented: PresentedFrame, action: Present, shown_us: int) -> dict[str, Any]:
    """The record of one presented frame; ``shown_us`` is when it was ready (client clock)."""
    reference = presented.reference
    record: dict[str, Any] = {
        "frame": presented.frame,
        "time_us": action.due_us,
        "latency_ms": (shown_us - action.due_us) / 1e3,
        "lod_mean": presented.lod_mean,
        "missed": presented.missed,
        "half": presented.half,
        "buffer_ms": presented.buffer_ms,
        "bytes_tiles": action.traffic.tiles_bytes,
        "bytes_reference": action.traffic.reference_bytes,
        "reference_frame": reference.frame if reference else None,
        "aligned_share": 0.0 if presented.confidence is None else _share(presented.confidence),
        "reference_kind": "" if presented.reference is None else presented.reference.kind.value,
    }
    if reference is not None and reference.frame == presented.frame:  # others tell of age, not of prediction
        there, here = reference.camera.pose, presented.camera.pose
        record["prediction_error_deg"] = math.degrees(angle_between(there.rotation, here.rotation))
        record["prediction_error_m"] = math.dist(there.position, here.position)
    record["restorer"] = presented.tier
    record["effects"] = sorted(presented.effects.on)
    record |= {f"{STAGE}{stage}": value for stage, value in presented.stages_ms.items()}
    return record


def _share(confidence: F32) -> float:
    """Share of pixels with any ``confidence`` [H, W]. Runs between two pictures, so it must be quick."""
    return cv2.countNonZero(confidence) / confidence.size


def summary(records: list[dict[str, Any]], stats: PlayStats) -> dict[str, Any]:
    """The last line of a report: counts, goodput, the mean of every figure of the frames, and the effects' shares."""
    means = averages(records)
    for key in ("frame", "time_us", "reference_frame", "bytes_tiles", "bytes_reference"):
        means.pop(key, None)
    latencies = [record["latency_ms"] for record in records]
    received = stats.bytes_tiles + stats.bytes_reference + stats.bytes_other
    seconds = (stats.last_byte_us - stats.first_byte_us) / 1e6 if stats.first_byte_us is not None else 0.0
    return {
        "summary": True,
        "frames": stats.frames,
        "frames_missed": stats.missed,
        "frames_dropped": stats.dropped,
        "frames_interpolated": stats.interpolated,
        "frames_half": sum(record["half"] for record in records),
        "decode_errors": stats.decode_errors,
        "keyframe_requests": stats.keyframe_requests,
        "reconnects": stats.reconnects,
        "away_ms": stats.away_us / 1e3,
        "notices": list(stats.notices),
        "bytes_tiles": stats.bytes_tiles,
        "bytes_reference": stats.bytes_reference,
        "bytes_other": stats.bytes_other,
        "goodput_mbps": received * 8 / seconds / 1e6 if seconds > 0 else 0.0,
        **means,
        **steadiness(records, stats.started_us),
        "effects": tally(map(_effects, records)),
        "restorers": dict(Counter(str(record["restorer"]) for record in records)),
        "first_frame_ms": None if stats.started_us is None else (stats.started_us - stats.made_us) / 1e3,
        "latency_p95_ms": float(np.percentile(latencies, 95)) if latencies else None,
    }


def _effects(record: Mapping[str, Any]) -> tuple[frozenset[Pass], dict[str, float]]:
    """What was on in a frame, and its stages' milliseconds."""
    stages = {key.removeprefix(STAGE): float(value) for key, value in record.items() if key.startswith(STAGE)}
    return frozenset(map(Pass, record["effects"])), stages


def json_line(record: Mapping[str, Any]) -> str:
    """One strict JSON line; numbers that are not finite become null."""
    clean = {k: None if isinstance(v, float) and not math.isfinite(v) else _rounded(v) for k, v in record.items()}
    return json.dumps(clean, allow_nan=False)


def _rounded(value: Any) -> Any:
    return round(value, 6) if isinstance(value, float) else value


def json_text(records: Iterable[Mapping[str, Any]]) -> str:
    """All lines of a report."""
    return "".join(json_line(record) + "\n" for record in records)
