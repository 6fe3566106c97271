"""Every method on every case, methods interleaved, and what the project asks of them."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from statistics import mean, median
from typing import Any

from rich.console import Console
from rich.progress import track

from cags_bench.jsonl import JsonObject, provenance, summary
from cags_bench.restore.cases import Case, Cases
from cags_bench.restore.checks import checks_of
from cags_bench.restore.command import RestoreBenchSettings
from cags_bench.restore.conditions import Conditions
from cags_bench.restore.methods import Method, methods_of
from cags_common.geometry import F32
from cags_common.metrics import covered_mask, psnr, ssim

Score = dict[str, float]


def restoration(settings: RestoreBenchSettings) -> Iterator[JsonObject]:
    """One line a case and method, then the summary."""
    lines: list[JsonObject] = []
    for line in measured(Cases(settings), methods_of(settings.method_list, settings.threads), settings):
        lines.append(line)
        yield line
    yield summary("restore", checks_of(lines), table=table_of(lines))


def measured(cases: Cases, methods: Sequence[Method], conditions: Conditions) -> Iterator[JsonObject]:
    """One line a case and method, with a progress bar."""
    lpips = _lpips(conditions.lpips)
    console = Console(file=sys.stderr)
    for case in track(cases, "restoring", total=len(cases), console=console, transient=True):
        yield from _case_lines(case, methods, conditions.repetitions, lpips)


def _case_lines(case: Case, methods: Sequence[Method], repetitions: int, lpips: Any) -> Iterator[JsonObject]:
    first = {m.name: m.run(case) for m in methods}  # warms up too
    times = {name: [] if repetitions else [stages] for name, (_, stages) in first.items()}
    for _ in range(repetitions):
        for method in methods:
            times[method.name].append(method.run(case)[1])
    for name, (picture, stages) in first.items():
        spread = [sum(t.values()) for t in times[name]]
        yield {
            "method": name,
            **case.labels,
            **scores(picture, case, lpips),
            **{f"{stage}_ms": median(t[stage] for t in times[name]) for stage in stages},
            "spread_ms": max(spread) - min(spread),
            "warm_up": 1 if repetitions else 0,
            "repetitions": repetitions,
            **provenance(),
        }


def scores(picture: F32, case: Case, lpips: Any) -> Score:
    """PSNR over covered pixels and over all, SSIM, LPIPS where its weights are given; the distorted picture's PSNR."""
    covered = covered_mask(case.truth_alpha)
    out = {
        "psnr_covered_db": psnr(picture, case.truth, covered),
        "psnr_db": psnr(picture, case.truth),
        "ssim": ssim(picture, case.truth),
        "distorted_psnr_covered_db": psnr(case.distorted.rgb.clip(0, 1), case.truth, covered),
    }
    return out if lpips is None else {**out, "lpips": lpips.distance(picture, case.truth)}


def table_of(lines: Sequence[JsonObject]) -> dict[str, JsonObject]:
    """Means by method: PSNR by LoD, pose error and kind of reference, SSIM and LPIPS, time of restoring by size."""
    return {name: _means(_where(lines, method=name)) for name in dict.fromkeys(str(x["method"]) for x in lines)}


def _means(own: Sequence[JsonObject]) -> JsonObject:
    out: JsonObject = {}
    for key, title in (("lod_share", "lod"), ("error", "error"), ("reference", "reference")):
        for value in dict.fromkeys(x[key] for x in own):
            shown = f"{value:g}" if isinstance(value, float) else value
            out[f"{title} {shown}"] = mean(x["psnr_covered_db"] for x in _where(own, **{key: value}))
    for key in ("ssim", "lpips"):
        if key in own[0]:
            out[key] = mean(x[key] for x in own)
    if "restore_ms" in own[0]:
        sizes = dict.fromkeys(x["size"] for x in own)
        out |= {f"ms {size}": mean(x["restore_ms"] for x in _where(own, size=size)) for size in sizes}
    return out


def _where(lines: Iterable[JsonObject], **fields: object) -> list[JsonObject]:
    return [x for x in lines if all(x[k] == v for k, v in fields.items())]


def _lpips(weights: str) -> Any:
    if not weights:
        return None
    from cags_common.lpips import Lpips

    return Lpips(weights)
