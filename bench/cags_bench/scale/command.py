"""``cags-bench scale``: what viewers cost a server, and the sessions that 1, 2, 4, ... servers carry at that cost."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cags_bench.jsonl import check, provenance, summary
from cags_bench.scale.cluster import Cluster, Load
from cags_common.errors import ConfigError
from cags_common.settings import add_settings, check_settings, load_settings, setting

SUMMARY = "What viewers cost a server with the closed loop on, and the sessions that several servers carry."
EXAMPLES = """\
  cags-bench scale --table sizing.md --json
  cags-bench scale --scene clip.cags --viewers 8 --mbps 10
  cags-bench scale --job-ms 12 --workers 8 --servers 16 --plot curve.png
"""

SERVED = 0.99
"""Share of references in time at which a load is carried."""


@dataclass(frozen=True)
class ScaleSettings:
    """What is watched, what the servers are like, and who comes."""

    sizes: str = setting("10000,30000", "splats of the built-in scenes that are watched, comma separated")
    scene: str = setting("", "a scene or a bundle (folder that ends in .cags) to watch instead")
    viewers: int = setting(4, "viewers at one server", low=1, high=256)
    mbps: float = setting(5.0, "link of each viewer, Mbps", low=0.1, high=1000.0)
    clip_frames: int = setting(45, "media frames that each viewer watches", low=2, high=100_000)
    rounds: int = setting(2, "times that every way to watch is played, in turns", low=1, high=100)
    crowd: int = setting(20, "viewers at 5 frames a second and 3 Mbps on two cores; 0: not", low=0, high=1000)
    job_ms: float | None = setting(
        None, "processor time of one reference, ms, for the model of servers; measured when not given", low=0.1
    )
    servers: int = setting(8, "most servers", low=1, high=256)
    workers: int = setting(2, "references rendered at the same time by one server", low=1, high=256)
    stay_s: float = setting(20.0, "mean length of a session, seconds", low=0.1, high=1e5)
    seconds: float = setting(30.0, "virtual time of a run of the model, seconds", low=1.0, high=3600.0)
    seed: int = setting(1, "of the walks, and of the viewers' coming and going", low=0)
    plot: str = setting("", "PNG file for the curve; none when empty")
    table: str = setting("", "Markdown file for the sizing table; none when empty")
    cache: str = setting("", "folder of encoded bundles to reuse; empty: the user's cache folder")

    def __post_init__(self) -> None:
        check_settings(self)
        for size in self.sizes.split(","):
            if not size.isdecimal() or int(size) < 1:
                raise ConfigError(f"sizes = {self.sizes!r}: {size!r} is no number of splats; give e.g. 10000,30000")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """See :mod:`cags_bench.cli`."""
    add_settings(parser, ScaleSettings)


def run(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """See :mod:`cags_bench.cli`."""
    settings = load_settings(ScaleSettings, arguments)
    provenance()  # now: figures are of the code that a long run began with
    checks: list[dict[str, Any]] = []
    job_ms = settings.job_ms
    if job_ms is None:
        from cags_bench.scale.sizing import crowd_line, judged, scenes, sizing_table, viewer_lines

        lines: list[dict[str, Any]] = []
        for scene in scenes(settings):
            for line in viewer_lines(scene, settings):
                lines.append(line)
                yield line
        if settings.crowd:
            lines.append(crowd_line(settings))
            yield lines[-1]
        if settings.table:
            Path(settings.table).write_text(sizing_table(lines), encoding="utf-8")
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
    """The curve of the model, and the death of one server."""
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
    worst = min(sessions / (servers * curve[1]) for servers, sessions in curve.items()) if curve[1] else 0.0
    checks = [check("sessions of N servers over N times those of one", ">= 0.95", round(worst, 3), worst >= 0.95)]
    if death:
        ok = death["share_on_time"] >= 0.95
        checks.append(check("references in time over a server's death", ">= 0.95", death["share_on_time"], ok))
    return checks


def capacity(servers: int, load: Load) -> int:
    """Most sessions of which :data:`SERVED` of the references come in time, by bisection."""
    ideal = servers * load.workers * 1e3 / load.job_ms / load.fps
    low, high = 0, max(2, int(ideal * 1.5) + 1)
    while high - low > 1:
        middle = (low + high) // 2
        carried = Cluster(servers, replace(load, sessions=middle)).run().share >= SERVED
        low, high = (middle, high) if carried else (low, middle)
    return low


def _after_a_death(servers: int, curve: dict[int, int], load: Load) -> dict[str, Any]:
    """One of ``servers`` dies midway under the load that the others can carry."""
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
    figure.savefig(path, dpi=110)
