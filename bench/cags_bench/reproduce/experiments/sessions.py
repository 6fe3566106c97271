"""One row for each session that has been played; shows the progress of a full-size run."""

from __future__ import annotations

from cags_bench.confidence import interval_of_play
from cags_bench.reproduce.cases import StreamCase
from cags_bench.reproduce.experiments.streaming import FLICKER, PSNR, SSIM, link_title
from cags_bench.reproduce.methods import METHODS
from cags_bench.reproduce.plan import Context
from cags_bench.reproduce.section import Cell, Section


def session_cases(context: Context) -> list[StreamCase]:
    """All combinations of link, method and scene, ordered by link."""
    p = context.plan
    return [context.case(s, m, mbps) for mbps in p.links for s in p.scenes for m in p.methods]


def sessions(context: Context) -> Section:
    """One row per session."""
    cases, plan = session_cases(context), context.plan
    played = [case for case in cases if context.there(case)]
    rows = [_row(context, case) for case in played]
    return Section(
        name="sessions",
        title="Every session",
        paper="Behind figures 'fixed' and 'dynamic bandwidth'. The interval of the mean is of this walk, in blocks of "
        "nine frames.",
        columns=(
            "scene",
            "link",
            "method",
            "frames",
            "size",
            "PSNR [dB]",
            "95 % from",
            "to",
            "PSNR, 5th percentile",
            "SSIM",
            "flicker [1/255]",
            "goodput here [Mbps]",
            "processor [s]",
        ),
        rows=rows,
        notes=[
            f"{len(played)} of {len(cases)} sessions of {plan.frames} frames at {plan.width}x{plan.height} were played."
        ],
    )


def _row(context: Context, case: StreamCase) -> list[Cell]:
    result = context.result(case)
    summary, series = result["summary"], [float(frame[PSNR]) for frame in result["frames"]]
    mean = interval_of_play(series)
    return [
        case.scene,
        link_title(case.mbps),
        METHODS[case.method].title,
        len(series),
        f"{case.width}x{case.height}",
        mean.mean,
        mean.low,
        mean.high,
        sorted(series)[len(series) // 20],
        summary.get(SSIM),
        summary.get(FLICKER),
        summary.get("goodput_mbps"),
        context.runner.cpu_s(case),
    ]
