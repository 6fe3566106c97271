"""The sweep behind ``cags-bench cost``."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from cags_bench.cost.budget import Proposal, proposed, write_config
from cags_bench.cost.coding import coding_stages
from cags_bench.cost.comparing import beaten_by, default_of, line, marginal_ms_per_db, pareto
from cags_bench.cost.correcting import correcting_stages
from cags_bench.cost.drawing import drawing_stages, graphics
from cags_bench.cost.effects import effect_checks, effect_stages
from cags_bench.cost.engine import Measured, Stage, gathered, measure
from cags_bench.cost.looking import looking_stages
from cags_bench.cost.moments import Workbench, capture
from cags_bench.cost.plays import session_groups
from cags_bench.cost.referring import reference_stages
from cags_bench.cost.settings import CostSettings
from cags_bench.cost.shrinking import pruning_stages, shrinking_stages
from cags_bench.inputs import check_scenes, check_traces, check_walks
from cags_bench.jsonl import JsonObject, check, provenance, summary
from cags_bench.outputs import check_output_file
from cags_common.files import writable_folder

Groups = Sequence[Sequence[Measured]]


def sweep(settings: CostSettings) -> Iterator[dict[str, Any]]:
    """Measure all stages; yield one line per point, then the summary. Writes the page and the proposal if asked.

    Raises :class:`CagsError`; wrong inputs and outputs are refused before anything is measured.
    """
    _check(settings)
    found = graphics()
    if isinstance(found, str):
        yield {"benchmark": "cost", "left_out": "rasterise on a graphics adapter", "reason": found} | provenance()
    groups = gathered(_moments(settings))
    if settings.seeds:
        groups += session_groups(settings, _progress("sessions"))
    for group in groups:
        for one in group:
            yield line(one, default_of(group)) | provenance()
    checks = checks_of(groups)
    if settings.out:
        from cags_bench.cost.page import write_page

        write_page(Path(settings.out), groups, checks, settings)
    proposal = None if settings.budget_ms is None else proposed(groups, settings.budget_ms)
    if proposal is not None and settings.config_out:
        write_config(Path(settings.config_out), proposal, settings)
    yield _summary(groups, checks, proposal)


def _check(settings: CostSettings) -> None:
    if settings.out:
        writable_folder(Path(settings.out))
    if settings.config_out:
        check_output_file("config_out", settings.config_out)
    check_scenes(settings.scene_list)
    check_traces([settings.trace])
    check_walks([settings.poses])


def _moments(settings: CostSettings) -> Iterator[list[Measured]]:
    """All stages at every moment, scene and size; what does not depend on the size at the smallest alone."""
    with tempfile.TemporaryDirectory(prefix="cags-cost-") as scratch:
        for number, scene in enumerate(settings.scene_list):
            for size in settings.size_list:
                for bench in capture(settings, number, scene, size).each():
                    stages = _stages(bench, Path(scratch), sized=False) if size == settings.size_list[0] else []
                    where = f"{scene}, {size[0]}x{size[1]}, moment {bench.at + 1}"
                    for name, of in (("", stages), (f"{size[0]}x{size[1]}", _stages(bench, Path(scratch), sized=True))):
                        yield measure(of, bench.key, name, settings.repetitions, _progress(where))


def _stages(bench: Workbench, scratch: Path, *, sized: bool) -> list[Stage]:
    """Stages of a moment whose work depends on the picture's size, or the others; a scene is encoded once."""
    if not sized:
        of_scene = [] if bench.at else coding_stages(bench, scratch)
        return [*looking_stages(bench), *shrinking_stages(bench), *of_scene]
    return [
        *drawing_stages(bench),
        *reference_stages(bench),
        *correcting_stages(bench),
        *effect_stages(bench),
        *pruning_stages(bench),
    ]


def checks_of(groups: Groups) -> list[JsonObject]:
    """Whether every stage has the product's default, and whether that is on the front; and the effects' checks."""
    without = [_name(group) for group in groups if default_of(group) is None]
    beaten = [f"{_name(group)} ({', '.join(one.label for one in by)})" for group in groups if (by := beaten_by(group))]
    return [
        check("stages without the product's default", "none", without, not without),
        check("defaults that another point surely beats in quality and cost", "none", beaten, not beaten),
        *effect_checks(groups),
    ]


def _name(group: Sequence[Measured]) -> str:
    size = group[0].size
    return group[0].stage.name + (f" at {size}" if size else "")


def _summary(groups: Groups, checks: list[JsonObject], proposal: Proposal | None) -> JsonObject:
    return summary(
        "cost",
        checks,
        stages=len({group[0].stage.name for group in groups}),
        points=sum(map(len, groups)),
        one_more_db_costs_ms={
            _name(group): [[a, b, round(ms, 3)] for a, b, ms in marginal_ms_per_db(pareto(group))] for group in groups
        },
        proposal=None if proposal is None else proposal.line(),
    )


def _progress(what: str) -> Callable[[int, int], None]:
    def tell(done: int, total: int) -> None:
        if sys.stderr.isatty():
            print(f"\rcost: {what}: {done}/{total}", end="\n" if done == total else "", file=sys.stderr, flush=True)

    return tell
