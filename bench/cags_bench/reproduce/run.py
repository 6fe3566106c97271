"""The run behind ``cags-bench reproduce``."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from cags_bench.film.metrics import lacking
from cags_bench.inputs import check_scenes, check_traces, check_walks
from cags_bench.jsonl import check, provenance, summary
from cags_bench.reproduce.cache import ResultCache
from cags_bench.reproduce.cases import Runner
from cags_bench.reproduce.experiments import EXPERIMENTS
from cags_bench.reproduce.marking import marked
from cags_bench.reproduce.methods import METHODS
from cags_bench.reproduce.page import write_claims, write_page, write_section
from cags_bench.reproduce.plan import Context, Experiment, Plan
from cags_bench.reproduce.prepare import prepare
from cags_bench.reproduce.section import Section
from cags_bench.reproduce.settings import ReproduceSettings
from cags_bench.reproduce.words import page_text, renew
from cags_common.errors import ConfigError
from cags_common.files import writable_folder

QUICK_LIMIT_MIN = 25.0

SEGMENT = Path("../shared/network/5gophers/paper_segment_3249_3549.csv")
"""The paper's segment of 5Gophers, where a checkout has it beside itself."""

WALKS = Path("../shared/poses/eyenavgs_nthu")
"""Recorded walks of people, likewise."""

IN_PARTS = {"sessions", "rivals"}
"""Experiments that can be shown as far as sessions were played."""


def reproduce(settings: ReproduceSettings) -> Iterator[dict[str, Any]]:
    """Make the chosen experiments; every finished one is on disk before the next begins.

    Raises :class:`CagsError`; wrong inputs and outputs are refused before anything is computed.
    """
    chosen = _chosen(settings)
    plan = _plan(settings)
    if settings.page:
        page_text(Path(settings.page))  # a wrong name is told now, not after the run
    if chosen:
        _check(settings, plan)
    started = time.monotonic()

    def tell(what: str) -> None:
        _tell(f"{(time.monotonic() - started) / 60:.1f} min: {what}")

    context = Context(plan, Runner(ResultCache(), settings.cache, settings.device), tell)
    out, sections = Path(settings.out), list[Section]()
    cases = [case for experiment in chosen for case in experiment.cases(context)]
    if not settings.kept:
        prepare(context.runner, cases, settings.workers or os.cpu_count() or 1, tell)
    for experiment in chosen:
        section = marked(experiment.run(context), plan)
        sections.append(section)
        tell(f"made: {section.title}")
        write_section(out, section)
        write_claims(out, sections)
        write_page(out, sections, plan)
        for line in section.lines():
            yield line | provenance()
    minutes = (time.monotonic() - started) / 60
    if settings.all and settings.quick:
        sections.append(_in_time(minutes))
        write_claims(out, sections)
    if settings.page:
        renew(Path(settings.page), out)
    checks = [one for section in sections for one in section.checks]
    yield summary(
        "reproduce", checks, experiments=[one.name for one in chosen], minutes=round(minutes, 2), out=str(out)
    )


def _check(settings: ReproduceSettings, plan: Plan) -> None:
    writable_folder(Path(settings.out))
    check_walks([plan.poses])
    check_traces([plan.trace])
    check_scenes(plan.scenes)


def _in_time(minutes: float) -> Section:
    """How long a quick run took."""
    one = check("quick run", f"< {QUICK_LIMIT_MIN:g} min", round(minutes, 1), minutes < QUICK_LIMIT_MIN)
    return Section("run", "The run itself", "", checks=[one])


def _chosen(settings: ReproduceSettings) -> list[Experiment]:
    if settings.all:
        return list(EXPERIMENTS.values())
    chosen = []
    for kind in ("table", "figure"):
        name = getattr(settings, kind)
        if name:
            known = [one.name for one in EXPERIMENTS.values() if one.kind == kind]
            if name not in known:
                raise ConfigError(f"{kind} = {name!r} is unknown; known: {', '.join(known)}")
            chosen.append(EXPERIMENTS[name])
    if not chosen and not settings.page:
        raise ConfigError("nothing is asked for; give --all, --table NAME, --figure NAME or --page FILE")
    if settings.kept and not {one.name for one in chosen} <= IN_PARTS:
        raise ConfigError("kept = true is for --table sessions or rivals: others are means over what may be missing")
    return chosen


def _plan(settings: ReproduceSettings) -> Plan:
    frames, width, height = (45, 640, 480) if settings.quick else (300, 1600, 1200)
    frames = settings.frames or frames
    return Plan(
        scenes=tuple(_with_frames(scene, frames) for scene in settings.scenes.split()),
        poses=settings.poses,
        trace=settings.trace or (str(SEGMENT) if SEGMENT.is_file() else "generated:5g-mmwave"),
        frames=frames,
        width=settings.width or width,
        height=settings.height or height,
        quick=settings.quick,
        lpips=settings.lpips,
        walks=settings.walks or (str(WALKS) if WALKS.is_dir() else ""),
        video=_measurable(settings),
        chosen=_methods(settings.methods),
        over=_links(settings.links),
        kept=settings.kept,
    )


def _methods(text: str) -> tuple[str, ...]:
    for name in (names := text.split()):
        try:
            METHODS[name]
        except KeyError:
            raise ConfigError(f"methods: {name!r} is unknown; known: {', '.join(METHODS)}") from None
    return tuple(names)


def _links(text: str) -> tuple[float | None, ...]:
    try:
        links = tuple(None if word == "trace" else float(word) for word in text.split())
    except ValueError:
        raise ConfigError(f"links = {text!r} must be numbers (Mbps of the paper) and 'trace'") from None
    if any(mbps is not None and not 0 < mbps < 1e6 for mbps in links):
        raise ConfigError(f"links = {text!r}: rates must be above 0 and below 1e6 Mbps")
    return links


def _measurable(settings: ReproduceSettings) -> tuple[str, ...]:
    """Metrics of films that can be had here; of the others it is told how."""
    missing = lacking(settings.metrics)
    for metric, way_out in missing.items():
        _tell(f"{metric} is not measured: {way_out}")
    return tuple(metric for metric in settings.metrics if metric not in missing)


def _with_frames(scene: str, frames: int) -> str:
    """The built-in scene moves for as long as it is asked to."""
    if scene.startswith("procedural") and "frames=" not in scene:
        return f"{scene}{',' if ':' in scene else ':'}frames={frames}"
    return scene


def _tell(what: str) -> None:
    print(f"reproduce: {what}", file=sys.stderr, flush=True)
