"""The summary of a play in words, for people: what was shown, how good it was, and what it took."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from cags_client.output.report import STAGE
from cags_client.output.steadiness import EVEN_MS
from cags_common.words import counted

Row = tuple[str, str]


MANY = 0.25
"""Share of frames from which on their being skipped or incomplete is told as a shortage."""


def summary_rows(summary: Mapping[str, Any], clip_frames: int) -> list[Row]:
    """Names and values of a :func:`~cags_client.output.report.summary` of a clip of ``clip_frames`` media frames."""
    rows = [("shown", _shown(summary, clip_frames))]
    if summary.get("even_share") is not None:
        rows.append(("steady", _steady(summary)))
    if summary.get("psnr_distorted_db") is not None:
        rows.append(("picture", _picture(summary)))
    if summary.get("lod_mean") is not None:
        rows.append(("detail", f"{summary['lod_mean']:.1f} quality levels a splat in view, on average"))
    rows.append(("received", _received(summary)))
    if summary.get("prediction_error_deg") is not None:
        off = f"{summary['prediction_error_deg']:.1f}°, {100 * summary['prediction_error_m']:.0f} cm"
        rows.append(("prediction", f"{off} between where the server expected the viewer and where they were"))
    rows += _times(summary)
    return rows + _trouble(summary)


def _shown(summary: Mapping[str, Any], clip_frames: int) -> str:
    text = f"{summary['frames']} of {clip_frames} frames"
    if summary["frames_half"]:
        text += f", {summary['frames_half']} of them at half resolution"
    if summary.get("frames_interpolated"):
        text += f"; {summary['frames_interpolated']} pictures between them"
    if summary["frames_dropped"]:
        text += f"; {summary['frames_dropped']} skipped, the next one being due"
    if summary["frames_missed"]:
        text += f"; {summary['frames_missed']} without all of their data"
    return text


def _steady(summary: Mapping[str, Any]) -> str:
    even = f"{100 * summary['even_share']:.0f} % of gaps at most {EVEN_MS:.0f} ms"
    text = f"{summary['frames_per_s']:.0f} frames a second, {even}"
    if summary["freezes"]:
        text += f"; frozen {summary['freezes']} times, {summary['frozen_ms'] / 1e3:.1f} s in all"
    if summary.get("psnr_restored_step_p95_db") is not None:
        text += f"; 95 % of frames within {summary['psnr_restored_step_p95_db']:.1f} dB of the previous one"
    return text


def _picture(summary: Mapping[str, Any]) -> str:
    before, after = summary["psnr_distorted_db"], summary.get("psnr_restored_db")
    if after is None:
        return f"{before:.1f} dB PSNR against the truth"
    structure = f"SSIM {summary['ssim_restored']:.3f}, {summary['ssim_distorted']:.3f} before"
    return f"{after:.1f} dB PSNR against the truth, {before:.1f} dB before restoration; {structure}"


def _received(summary: Mapping[str, Any]) -> str:
    tiles, references, other = (summary[f"bytes_{kind}"] / 1e6 for kind in ("tiles", "reference", "other"))
    parts = f"{tiles:.2f} MB of tiles, {references:.2f} MB of references, {other:.2f} MB of codebooks and weights"
    return f"{parts}; {summary['goodput_mbps']:.1f} Mbps"


def _times(summary: Mapping[str, Any]) -> list[Row]:
    stages = {key.removeprefix(STAGE): value for key, value in summary.items() if key.startswith(STAGE)}
    rows = []
    if stages:
        each = ", ".join(f"{stage} {value:.1f}" for stage, value in stages.items())
        rows.append(("work", f"{each} ms, each where it was done"))
    if summary.get("latency_ms") is not None:
        late = f"{summary['latency_ms']:.0f} ms after the frame was due, 95 % within {summary['latency_p95_ms']:.0f} ms"
        rows.append(("shown after", late))
    return rows


def _trouble(summary: Mapping[str, Any]) -> list[Row]:
    """What hardly ever is, and is told of only then."""
    rows = _shortages(summary)
    if summary["reconnects"] or summary["away_ms"]:
        taken_up = f"connection taken up again {counted(summary['reconnects'], 'time')}"
        rows.append(("away", f"{summary['away_ms'] / 1e3:.1f} s without a server; {taken_up}"))
    if summary["decode_errors"]:
        asked = f"payloads that did not decode: {summary['decode_errors']}; key pictures asked for: "
        rows.append(("damaged", asked + str(summary["keyframe_requests"])))
    return rows


def _shortages(summary: Mapping[str, Any]) -> list[Row]:
    """What the play was short of, as far as a client can see it."""
    words, shown = [], max(summary["frames"], 1)
    skipped = summary["frames_dropped"] / (shown + summary["frames_dropped"])
    if skipped > MANY:
        words.append(f"this machine: {100 * skipped:.0f} % of the frames skipped, being late")
    missed = summary["frames_missed"] / shown
    if missed > MANY:
        words.append(f"link or server: {100 * missed:.0f} % of the pictures without all of their data")
    return [("short of", "; ".join(words))] if words else []
