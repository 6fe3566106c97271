"""Every method on every case, methods interleaved, and what the project asks of them."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from statistics import mean, median
from typing import Any

from rich.console import Console
from rich.progress import track

from cags_bench.jsonl import JsonObject, check, provenance, summary
from cags_bench.restore.cases import Case, Cases
from cags_bench.restore.command import RestoreBenchSettings
from cags_bench.restore.methods import Method, methods_of
from cags_common.geometry import F32
from cags_common.metrics import covered_mask, psnr, ssim

Score = dict[str, float]


def restoration(settings: RestoreBenchSettings) -> Iterator[JsonObject]:
    """One line a case and method, then the summary."""
    methods = methods_of(settings.method_list, settings.threads)
    lpips = _lpips(settings.lpips)
    cases = Cases(settings)
    lines: list[JsonObject] = []
    console = Console(file=sys.stderr)
    for case in track(cases, "restoring", total=len(cases), console=console, transient=True):
        for line in _case_lines(case, methods, settings.repetitions, lpips):
            lines.append(line)
            yield line
    yield summary("restore", checks_of(lines), table=table_of(lines))


def _case_lines(case: Case, methods: list[Method], repetitions: int, lpips: Any) -> Iterator[JsonObject]:
    times: dict[str, list[dict[str, float]]] = {m.name: [] for m in methods}
    pictures = {m.name: m.run(case)[0] for m in methods}  # warms up too
    for _ in range(repetitions):
        for method in methods:
            times[method.name].append(method.run(case)[1])
    for method in methods:
        stages = {f"{stage}_ms": median(t[stage] for t in times[method.name]) for stage in times[method.name][0]}
        spread = [sum(t.values()) for t in times[method.name]]
        yield {
            "method": method.name,
            **case.labels,
            **scores(pictures[method.name], case, lpips),
            **stages,
            "spread_ms": max(spread) - min(spread),
            "warm_up": 1,
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
        "distorted_psnr_covered_db": psnr(case.distorted.rgb, case.truth, covered),
        "covered": float(covered.mean()),
    }
    return out if lpips is None else {**out, "lpips": lpips.distance(picture, case.truth)}


def table_of(lines: Iterable[JsonObject]) -> dict[str, JsonObject]:
    """Means by method: PSNR by LoD, gain kept at the largest pose error, time of restoring by picture size."""
    table: dict[str, JsonObject] = {}
    by_method: dict[str, list[JsonObject]] = {}
    for line in lines:
        by_method.setdefault(str(line["method"]), []).append(line)
    for name, own in by_method.items():
        table[name] = {
            **{f"lod {lod:g}": _mean(own, "psnr_covered_db", lod_share=lod) for lod in _values(own, "lod_share")},
            **{f"ms {size}": _mean(own, "restore_ms", size=size) for size in _values(own, "size")},
        }
    return table


def checks_of(lines: list[JsonObject]) -> list[JsonObject]:
    """The targets of the project that this run can speak of."""
    names = {str(line["method"]) for line in lines}
    out = [_never_lower(lines, name) for name in ("affine", "lite", "srresnet") if name in names]
    for name, limit in (("affine", 10.0), ("lite", 33.0)):
        if name in names and "1600x1200" in _values(lines, "size"):
            value = median(x["restore_ms"] for x in lines if x["method"] == name and x["size"] == "1600x1200")
            out.append(check(f"{name} at 1600x1200", f"<= {limit:g} ms", value, value <= limit))
    if "lite" in names:
        pairs = [("affine", 0.7), ("srresnet", -0.3), ("sr-align-ref", 0.0), ("cr-no-ref", 0.0), ("paper", 0.0)]
        out += [_better(lines, "lite", other, by) for other, by in pairs if other in names]
    return out


def _never_lower(lines: list[JsonObject], name: str) -> JsonObject:
    gains = [x["psnr_covered_db"] - x["distorted_psnr_covered_db"] for x in lines if x["method"] == name]
    return check(f"{name} never lower than distorted", ">= -0.1 dB each", min(gains), min(gains) >= -0.1)


def _better(lines: list[JsonObject], name: str, other: str, by_db: float) -> JsonObject:
    """Mean difference below the top of the ladder: at the top nothing is left to restore."""
    kept = [x for x in lines if x["lod_share"] < 1] or lines
    value = _mean(kept, "psnr_covered_db", method=name) - _mean(kept, "psnr_covered_db", method=other)
    return check(f"{name} against {other}", f">= {by_db:+g} dB", value, value >= by_db)


def _mean(lines: Iterable[JsonObject], key: str, **where: object) -> float:
    return mean(float(x[key]) for x in lines if all(x[k] == v for k, v in where.items()))


def _values(lines: Iterable[JsonObject], key: str) -> list[Any]:
    return sorted({line[key] for line in lines})


def _lpips(weights: str) -> Any:
    if not weights:
        return None
    from cags_common.lpips import Lpips

    return Lpips(weights)
