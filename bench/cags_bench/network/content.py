"""Plays a scene over every trace under every rate policy, in virtual time, and scores every third frame.

What a fall of the link does depends on what was on its way at that moment. A trace with an incident is therefore played
from several starts around it, each with another synthetic walk.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from cags_bench.confidence import interval
from cags_bench.parallel import in_parallel
from cags_bench.sim.seeds import seeded
from cags_bench.sim.session import Scenario, SessionResult, simulate
from cags_bench.traces import link_share, scaled_trace, splats_of
from cags_client.settings import ClientSettings
from cags_common.bundle import BundleReader
from cags_server.settings import ServerSettings
from cags_shaper.trace import Trace, open_trace

BLACK_SHARE = 0.1
"""A picture is black if its coverage is below this share of the clip's median."""

SCORE_EVERY = 3
"""Every n-th frame is compared with the truth."""

NONE_BUT_THE_FIRST = 1_000_000
"""Interval of compared frames if only the first picture matters."""

FIRST_FIGURES = ("first_picture_ms", "first_psnr_restored_db", "first_lpips_restored")

SPARE_S = 30.0
"""Length of the trace beyond the clip, for late starts."""


STEADY_S = 3.0
"""Length of plays on steady links, where nothing changes."""

APART_S = 0.5
"""Seconds between the starts of plays over one incident."""

_START = re.compile(r"(?<=:start_s=)\d+(\.\d+)?(?=:|$)")

SUMS = ("frames", "frames_missed", "freezes", "frozen_ms", "black_frames", "wasted_bytes")
"""Figures that are added up over plays. Of ``recovery_ms`` the largest counts, of the others the mean."""


@dataclass(frozen=True)
class Play:
    """One play: a shipped trace, its rates times ``share``, and a scenario for it."""

    trace: str
    policy: str
    share: float
    base: Scenario
    number: int = 0
    """Of the plays over this trace; each has another synthetic walk."""

    def scenario(self) -> Scenario:
        """The complete scenario."""
        reader = BundleReader.open(str(self.base.bundle))
        clip_s = reader.manifest.frames / reader.manifest.fps
        reader.close()
        steady = self.trace.startswith("generated:steady-")
        return replace(
            self.base,
            poses=seeded(self.base.poses, self.number),
            trace=str(scaled_trace(self.trace, self.share, seconds=clip_s + SPARE_S)),
            server=replace(self.base.server, abr=self.policy),
            client=replace(self.base.client, duration=min(STEADY_S, clip_s) if steady else None),
        )

    def figures(self) -> dict[str, Any]:
        """Play the scenario and return its figures."""
        scenario = self.scenario()
        return judge(simulate(scenario), open_trace(scenario.trace))


def content_lines(
    traces: list[str], policies: list[str], base: Scenario, *, like_splats: int, workers: int, starts: int = 1
) -> Iterator[dict[str, Any]]:
    """One line per trace and policy, over the plays of that trace (:func:`around`).

    Rates are scaled so that the scene gets as many bits per splat and second as a scene of ``like_splats`` splats over
    the original trace; 0: no scaling.
    """
    share = link_share(base.bundle, like_splats)
    groups = [
        (trace, policy, [Play(spec, policy, share, base, number) for number, spec in enumerate(around(trace, starts))])
        for trace in traces
        for policy in policies
    ]
    found = in_parallel(Play.figures, [play for _, _, plays in groups for play in plays], workers)
    for trace, policy, plays in groups:
        figures = together(list(islice(found, len(plays))))
        yield {"case": "content", "trace": trace, "share": share, "policy": policy, **figures}


def around(trace: str, starts: int) -> list[str]:
    """A trace that begins shortly before an incident (``:start_s=``), from ``starts`` moments around it, none before 0;
    any other trace as it is, once.
    """
    found = _START.search(trace)
    if found is None:
        return [trace]
    first_s = float(found[0]) - APART_S * (starts - 1) / 2
    times = [max(first_s + APART_S * number, 0.0) for number in range(starts)]
    return [f"{trace[: found.start()]}{time_s:g}{trace[found.end() :]}" for time_s in times]


def together(plays: list[dict[str, Any]]) -> dict[str, Any]:
    """The figures of several plays as one, with the PSNR of each play and 95 % intervals over the plays."""
    out: dict[str, Any] = {"plays": len(plays)}
    for name in plays[0]:
        values = [play[name] for play in plays if play[name] is not None]
        if not values:
            out[name] = None
        elif name in SUMS:
            out[name] = sum(values)
        else:
            out[name] = max(values) if name == "recovery_ms" else float(np.mean(values))
    if len(plays) > 1:
        for name in ("psnr_db", "missed_share"):
            spread = interval([play[name] for play in plays])
            out[f"{name}_95"] = [spread.low, spread.high]
    out["psnr_db_by_play"] = [play["psnr_db"] for play in plays]
    return out


def first_picture_lines(base: Scenario, traces: tuple[str, ...]) -> Iterator[dict[str, Any]]:
    """One line per trace, unscaled: time to the first picture of a scene of full size, and its quality.

    LPIPS is included if ``base`` names its weights.
    """
    for spec in traces:
        summary = simulate(replace(base, trace=spec, score_every=NONE_BUT_THE_FIRST)).summary
        figures = {name: summary[name] for name in FIRST_FIGURES if name in summary}
        yield {"case": "first", "trace": spec, "splats": splats_of(base.bundle), **figures}


def scenario(bundle: Path, settings: Any, trace: str = "") -> Scenario:
    """The scenario described by the command's settings."""
    client = ClientSettings(width=settings.width, height=settings.height, restore=settings.restore)
    delay_us = round(settings.delay_ms * 1000)
    return Scenario(
        bundle,
        trace,
        settings.poses,
        ServerSettings(),
        client,
        settings.estimator,
        delay_us,
        score_every=SCORE_EVERY,
        lpips=settings.lpips,
    )


def judge(result: SessionResult, trace: Trace) -> dict[str, Any]:
    """The figures of one play."""
    records, summary = result.frames, result.summary
    psnr = [db for record in records if np.isfinite(db := record.get("psnr_restored_db", np.nan))]
    return {
        "frames": summary["frames"],
        "missed_share": summary["frames_missed"] / max(summary["frames"], 1),
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
    """Number of pictures in which almost nothing is drawn."""
    usual = float(np.median([record["drawn_share"] for record in records])) if records else 0.0
    return sum(record["drawn_share"] < BLACK_SHARE * usual for record in records)


def freezes(records: list[dict[str, Any]]) -> int:
    """How often a picture without its data follows one with its data."""
    return sum(not before["missed"] and after["missed"] for before, after in pairwise(records))


def recovery_ms(records: list[dict[str, Any]], trace: Trace) -> float | None:
    """Longest time from the end of an outage to the next complete frame, or to the last frame if none is complete; None
    without an outage.
    """
    last_us, worst = records[-1]["time_us"] if records else 0, None
    for end_us in outage_ends(trace, last_us):
        good_us = next((r["time_us"] for r in records if r["time_us"] >= end_us and not r["missed"]), last_us)
        worst = max(worst or 0.0, (good_us - end_us) / 1e3)
    return worst


def outage_ends(trace: Trace, until_us: int, least_us: int = 500_000) -> list[int]:
    """Times at which the link delivers again after at least ``least_us`` without any delivery."""
    ends, number = [], 1
    last_us = 0
    while (next_us := trace.time_of(number)) <= until_us:
        if next_us - last_us >= least_us:
            ends.append(next_us)
        last_us = next_us
        number = trace.count_until(next_us) + 1
    return ends
