"""The measurement behind ``cags-bench align``: the closed form's methods, and the stages that no method times."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

from cags_bench.align.command import AlignBenchSettings
from cags_bench.align.device import timed
from cags_bench.align.frames import frame_checks, frame_table, frames
from cags_bench.jsonl import JsonObject, check, provenance, summary
from cags_bench.restore.cases import Case, Cases
from cags_bench.restore.checks import checks_of, time_checks
from cags_bench.restore.experiment import measured, table_of
from cags_bench.restore.methods import methods_of
from cags_client import align
from cags_client.adapt import SirtAdapter
from cags_client.align import AlignSettings
from cags_common import raster
from cags_common.raster.base import DepthKind, RenderOptions

METHODS = (
    "none",
    "aligned",
    "aligned without erosion",
    "affine",
    "affine without PRPA",
    "affine with own depth",
    "sirt",
    "sirt + affine",
)

EXACT = (0.0, 0.0)


def measure(settings: AlignBenchSettings) -> Iterator[JsonObject]:
    """One line a case and method, one a frame at each accuracy, one a size with the other stages, then the summary."""
    cases, methods = Cases(settings), methods_of(list(METHODS), settings.threads)
    lines: list[JsonObject] = []
    for line in measured(cases, methods, settings):
        lines.append(line)
        yield line
    drawn = list(frames(cases, settings))
    yield from drawn
    stages = [_stages(cases.first(size, settings.error_list[0]), settings) for size in settings.size_list]
    yield from stages
    checks = [*checks_of(lines), *_identity(cases, settings), *time_checks(lines, settings.threads)]
    checks += frame_checks(drawn)
    for line in stages:
        title = f"one adapter step at 400x300, client at {line['size']}"
        checks.append(check(title, "<= 15 ms", line["adapt_ms"], line["adapt_ms"] <= 15))
    yield summary("align", checks, table=table_of(lines), frames=frame_table(drawn))


def _identity(cases: Cases, settings: AlignBenchSettings) -> Iterator[JsonObject]:
    """Under a reference of the exact pose nothing is hidden."""
    aligner = align.create("auto", AlignSettings(threads=settings.threads))
    for case in (cases.first(size, EXACT) for size in settings.size_list):
        assert case.distorted.depth is not None
        share = float(aligner.align(case.reference, case.distorted.depth, case.camera).occluded.mean())
        yield check(f"pixels called occluded under an identity, {case.labels['size']}", "0", share, share == 0)


def _stages(case: Case, settings: AlignBenchSettings) -> dict[str, Any]:
    """Median and least milliseconds of the client's render and of one adapter step, interleaved, after a warm-up."""
    draw = RenderOptions(threads=settings.threads)
    own_options = replace(case.own_options, depth=DepthKind.NONE)
    adapted, own = raster.create("auto").load(case.splats), case.own()
    adapter = SirtAdapter(len(case.splats))
    stages: dict[str, Callable[[], object]] = {
        "raster": lambda: case.held.render(case.camera, draw),
        "adapt": lambda: adapter.adapt(adapted, case.splats, case.reference, own, own_options),
    }
    spent = timed(stages, settings.repetitions)
    figures = {f"{name}_ms": statistics.median(values) for name, values in spent.items()}
    least = {f"{name}_least_ms": min(values) for name, values in spent.items()}
    return {"size": case.labels["size"], "splats": len(case.splats), **figures, **least, **provenance()}
