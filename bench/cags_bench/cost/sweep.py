"""The sweep behind ``cags-bench cost``."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

from cags_bench.bundles import cached_bundle
from cags_bench.cost.budget import CLIENT_STAGE, SERVER_STAGE, propose, write_config
from cags_bench.cost.coding import coding_stages
from cags_bench.cost.correcting import correcting_stages
from cags_bench.cost.drawing import drawing_stages
from cags_bench.cost.effects import EFFECTS, effect_checks, effect_stages
from cags_bench.cost.engine import Measured, Stage, marginal_ms_per_db, measure, pareto
from cags_bench.cost.looking import looking_stages
from cags_bench.cost.moments import capture
from cags_bench.cost.referring import reference_stages
from cags_bench.cost.settings import CostSettings
from cags_bench.cost.shrinking import shrinking_stages
from cags_bench.jsonl import check, provenance, summary
from cags_common.errors import ConfigError
from cags_encoder import EncodeSettings

LEAST_STAGES = 12
LEAST_POINTS = 3


def sweep(settings: CostSettings) -> Iterator[dict[str, Any]]:
    """Measure all stages; yield one line per point, then the summary. Writes the page and the proposal if asked."""
    if settings.config_out and settings.budget_ms is None:
        raise ConfigError("config_out needs a budget; give --budget-ms too")
    bundle = cached_bundle(settings.scene, settings.cache, EncodeSettings(frames=settings.frames))
    bench = capture(bundle, settings.width, settings.height, settings.trace, settings.poses)
    stages: list[Stage] = [
        *drawing_stages(bench),
        *reference_stages(bench),
        *looking_stages(settings.poses, bench.moment.camera.intrinsics),
        *correcting_stages(bench),
        *effect_stages(bench),
        *shrinking_stages(bench),
        *coding_stages(bench),
    ]
    measured = list(measure(stages, _progress))
    for one in measured:
        yield one.line() | provenance()
    by_stage = [list(group) for _, group in groupby(measured, key=lambda one: one.stage.name)]
    if settings.out:
        from cags_bench.cost.page import write_page

        write_page(Path(settings.out), by_stage, settings)
    proposal = None
    if settings.budget_ms is not None:
        stages_by_name = {group[0].stage.name: group for group in by_stage}
        proposal = propose(stages_by_name[CLIENT_STAGE], stages_by_name[SERVER_STAGE], settings.budget_ms)
        if settings.config_out:
            write_config(Path(settings.config_out), proposal, settings)
    yield summary(
        "cost",
        _checks(by_stage),
        stages=len(by_stage),
        points=len(measured),
        one_more_db_costs_ms={
            group[0].stage.name: [[a, b, round(ms, 3)] for a, b, ms in marginal_ms_per_db(pareto(group))]
            for group in by_stage
        },
        proposal=None if proposal is None else proposal.line(),
    )


def _checks(by_stage: list[list[Measured]]) -> list[dict[str, Any]]:
    fewest = min(len(group) for group in by_stage)
    defaults = sum(any(one.point.default for one in group) for group in by_stage)
    return [
        check("stages", f">= {LEAST_STAGES}", len(by_stage), len(by_stage) >= LEAST_STAGES),
        check("points a stage", f">= {LEAST_POINTS}", fewest, fewest >= LEAST_POINTS),
        check("stages with the shipped default marked", "all", defaults, defaults == len(by_stage)),
        *effect_checks(next(group for group in by_stage if group[0].stage.name == EFFECTS)),
    ]


def _progress(done: int, total: int) -> None:
    if sys.stderr.isatty():
        print(f"\rcost: {done}/{total}", end="\n" if done == total else "", file=sys.stderr, flush=True)
