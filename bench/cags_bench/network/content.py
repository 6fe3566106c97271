"""A scene over every trace under every rate policy, in virtual time, every frame scored."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from cags_bench.sim.session import Scenario, SessionResult, simulate
from cags_client.settings import ClientSettings
from cags_server.settings import ServerSettings
from cags_shaper.trace import Trace, open_trace

BLACK_SHARE = 0.1
"""A picture that covers less than this share of what the clip's pictures usually cover is black."""

SCORE_EVERY = 3
"""Every so many-th frame is compared with the truth."""


def content_lines(bundle: Path, traces: list[str], policies: list[str], base: Scenario) -> Iterator[dict[str, Any]]:
    """One line a trace and policy."""
    for spec in traces:
        for policy in policies:
            scenario = replace(base, bundle=bundle, trace=spec, server=replace(base.server, abr=policy))
            yield {"case": "content", "trace": spec, "policy": policy, **judge(simulate(scenario), open_trace(spec))}


def scenario(bundle: Path, settings: Any, trace: str = "") -> Scenario:
    """What the command's settings describe."""
    client = ClientSettings(width=settings.width, height=settings.height, restore=settings.restore)
    delay_us = round(settings.delay_ms * 1000)
    return Scenario(
        bundle, trace, settings.poses, ServerSettings(), client, settings.estimator, delay_us, score_every=SCORE_EVERY
    )


def judge(result: SessionResult, trace: Trace) -> dict[str, Any]:
    """The figures of one play."""
    records, summary = result.frames, result.summary
    psnr = [db for record in records if np.isfinite(db := record.get("psnr_restored_db", np.nan))]
    return {
        "frames": summary["frames"],
        "frames_missed": summary["frames_missed"],
        "freezes": freezes(records),
        "frozen_ms": sum(record["missed"] for record in records) * 1e3 / summary["fps"],
        "black_frames": black_frames(records),
        "first_picture_ms": summary["first_picture_ms"],
        "recovery_ms": recovery_ms(records, trace),
        "goodput_mbps": summary["goodput_mbps"],
        "capacity_mbps": summary["capacity_mbps"],
        "goodput_per_capacity": summary["goodput_mbps"] / summary["capacity_mbps"],
        "bytes_tiles": summary["bytes_tiles"],
        "bytes_reference": summary["bytes_reference"],
        "wasted_bytes": summary["wasted_bytes"],
        "wasted_share": summary["wasted_share"],
        "psnr_db": float(np.mean(psnr)) if psnr else None,
        "psnr_p5_db": float(np.percentile(psnr, 5)) if psnr else None,
        "ssim": summary["ssim_restored"],
    }


def black_frames(records: list[dict[str, Any]]) -> int:
    """Pictures in which next to nothing is drawn."""
    usual = float(np.median([record["drawn_share"] for record in records])) if records else 0.0
    return sum(record["drawn_share"] < BLACK_SHARE * usual for record in records)


def freezes(records: list[dict[str, Any]]) -> int:
    """Times that a picture was missing its data after one that had it."""
    return sum(not before["missed"] and after["missed"] for before, after in pairwise(records))


def recovery_ms(records: list[dict[str, Any]], trace: Trace) -> float | None:
    """The longest time from the end of an outage to the next frame that misses nothing; None without an outage."""
    worst = None
    for end_us in outage_ends(trace, records[-1]["time_us"] if records else 0):
        good = next((r["time_us"] for r in records if r["time_us"] >= end_us and not r["missed"]), None)
        if good is not None:
            worst = max(worst or 0.0, (good - end_us) / 1e3)
    return worst


def outage_ends(trace: Trace, until_us: int, least_us: int = 500_000) -> list[int]:
    """Times at which the link delivers again after ``least_us`` of nothing."""
    ends, number = [], 1
    last_us = 0
    while (next_us := trace.time_of(number)) <= until_us:
        if next_us - last_us >= least_us:
            ends.append(next_us)
        last_us = next_us
        number = trace.count_until(next_us) + 1
    return ends
