"""``cags-bench scale``: a server's cost per viewer, and the sessions that 1, 2, 4, ... servers carry at that cost."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from cags_bench.jsonl import check, provenance, summary
from cags_bench.outputs import check_output_file
from cags_bench.scale.cluster import Cluster, Load
from cags_bench.scale.settings import ScaleSettings
from cags_common.files import whole_file, write_whole
from cags_common.settings import add_settings, load_settings

SUMMARY = "Measure a server's cost per viewer, and the number of sessions that several servers carry."
EXAMPLES = """\
  cags-bench scale --table sizing.md --json
  cags-bench scale --scene clip.cags --viewers 8 --mbps 10
  cags-bench scale --job-ms 12 --workers 8 --servers 16 --plot curve.png
"""

SERVED = 0.99
"""Share of references in time for which a load counts as carried."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """See :mod:`cags_bench.cli`."""
    add_settings(parser, ScaleSettings)


def run(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """See :mod:`cags_bench.cli`."""
    settings = load_settings(ScaleSettings, arguments)
    for name in ("plot", "table"):
        if given := getattr(settings, name):
            check_output_file(name, given)
    checks: list[dict[str, Any]] = []
    job_ms = settings.job_ms
    if job_ms is None:
        from cags_bench.scale.sizing import crowd_line, judged, scenes, sizing_caption, sizing_table, viewer_lines

        lines: list[dict[str, Any]] = []
        for scene in scenes(settings):
            for line in viewer_lines(scene, settings):
                lines.append(line)
                yield line
        if settings.crowd:
            lines.append(crowd_line(settings))
            yield lines[-1]
        if settings.table:
            text = f"{sizing_table(lines)}\n{sizing_caption(lines, provenance())}\n"
            write_whole(Path(settings.table), text.encode())
        checks += judged(lines)
        job_ms = lines[0]["job_ms"]
    curve: dict[int, int] = {}
    death: dict[str, Any] = {}
    for line in _servers(settings, job_ms):
        yield line
        if "killed" in line:
            death = line
        else:
            curve[line["servers"]] = line["sessions"]
    checks += _curve_checks(curve, death)
    if settings.plot:
        _draw(curve, Path(settings.plot))
    yield summary("scale", checks, curve={str(n): sessions for n, sessions in curve.items()}, job_ms=job_ms)


def _servers(settings: ScaleSettings, job_ms: float) -> Iterator[dict[str, Any]]:
    """The model's curve, and the death of one server."""
    load = Load(
        1, job_ms=job_ms, workers=settings.workers, stay_s=settings.stay_s, seconds=settings.seconds, seed=settings.seed
    )
    curve: dict[int, int] = {}
    for servers in _doublings(settings.servers):
        curve[servers] = capacity(servers, load)
        yield {
            "case": "servers",
            "servers": servers,
            "sessions": curve[servers],
            "per_server": curve[servers] / servers,
        }
    if max(curve) > 1:
        yield {"case": "servers", "servers": max(curve), "killed": 1, **_after_a_death(max(curve), curve, load)}


def _curve_checks(curve: dict[int, int], death: dict[str, Any]) -> list[dict[str, Any]]:
    several = {servers: sessions for servers, sessions in curve.items() if servers > 1}
    checks = []
    if several:  # one server always carries as many as one
        worst = min(sessions / (servers * curve[1]) for servers, sessions in several.items()) if curve[1] else 0.0
        name = "sessions of N servers over N times those of one"
        checks.append(check(name, ">= 0.95", round(worst, 3), worst >= 0.95))
    if death:
        ok = death["share_on_time"] >= 0.95
        checks.append(check("references in time over a server's death", ">= 0.95", death["share_on_time"], ok))
    return checks


def capacity(servers: int, load: Load) -> int:
    """Largest number of sessions with at least :data:`SERVED` of the references in time, by bisection."""
    ideal = servers * load.workers * 1e3 / load.job_ms / load.fps
    low, high = 0, max(2, int(ideal * 1.5) + 1)
    while high - low > 1:
        middle = (low + high) // 2
        carried = Cluster(servers, replace(load, sessions=middle)).run().share >= SERVED
        low, high = (middle, high) if carried else (low, middle)
    return low


def _after_a_death(servers: int, curve: dict[int, int], load: Load) -> dict[str, Any]:
    """One of ``servers`` dies in the middle of a run with the load that the others can carry."""
    sessions = curve[servers] * (servers - 1) // servers
    outcome = Cluster(servers, replace(load, sessions=sessions)).run(kill_at_s=load.seconds / 2)
    return {"sessions": sessions, "share_on_time": round(outcome.share, 4), "imbalance": outcome.peak_imbalance}


def _doublings(most: int) -> list[int]:
    counts = [1]
    while counts[-1] * 2 <= most:
        counts.append(counts[-1] * 2)
    return counts if counts[-1] == most else [*counts, most]


def _draw(curve: dict[int, int], path: Path) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.plot(list(curve), list(curve.values()), "o-", label="carried")
    axes.plot(list(curve), [n * curve[1] for n in curve], "--", color="grey", label="N times one server")
    axes.set(xlim=0, ylim=0, xticks=list(curve))
    axes.grid(alpha=0.3)
    axes.set_xlabel("servers")
    axes.set_ylabel("sessions")
    axes.legend()
    with whole_file(path) as writing:
        figure.savefig(writing, dpi=110, format=path.suffix[1:].lower())
