"""``cags-bench scale``: the sessions that 1, 2, 4, ... servers carry, and what the death of one costs."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cags_bench.jsonl import check, summary
from cags_bench.scale.cluster import Cluster, Load
from cags_common.settings import add_settings, check_settings, load_settings, setting

SUMMARY = "Sessions that several servers behind a balancer carry, in virtual time."
EXAMPLES = """\
  cags-bench scale
  cags-bench scale --job-ms 12 --workers 8 --servers 16 --plot curve.png
"""

SERVED = 0.99
"""Share of references in time at which a load is carried."""


@dataclass(frozen=True)
class ScaleSettings:
    """What the servers are like, and who comes."""

    servers: int = setting(8, "most servers", low=1, high=256)
    job_ms: float = setting(
        18.0, "rendering and coding one reference, ms (default: 30,000 splats at 400x300 on one EPYC core)", low=0.1
    )
    workers: int = setting(2, "references rendered at the same time by one server", low=1, high=256)
    stay_s: float = setting(20.0, "mean length of a session, seconds", low=0.1, high=1e5)
    seconds: float = setting(30.0, "virtual time of a run, seconds", low=1.0, high=3600.0)
    seed: int = setting(1, "of the viewers' coming and going", low=0)
    plot: str = setting("", "PNG file for the curve; none when empty")

    def __post_init__(self) -> None:
        check_settings(self)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """See :mod:`cags_bench.cli`."""
    add_settings(parser, ScaleSettings)


def run(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """See :mod:`cags_bench.cli`."""
    settings = load_settings(ScaleSettings, arguments)
    load = Load(
        1, job_ms=settings.job_ms, workers=settings.workers, stay_s=settings.stay_s, seconds=settings.seconds,
        seed=settings.seed,
    )  # fmt: skip
    curve: dict[int, int] = {}
    for servers in _doublings(settings.servers):
        curve[servers] = capacity(servers, load)
        yield {"servers": servers, "sessions": curve[servers], "per_server": curve[servers] / servers}
    lost = _after_a_death(max(curve), curve, load) if max(curve) > 1 else None
    if lost is not None:
        yield {"servers": max(curve), "killed": 1, **lost}
    if settings.plot:
        _draw(curve, Path(settings.plot))
    worst = min(sessions / (servers * curve[1]) for servers, sessions in curve.items()) if curve[1] else 0.0
    checks = [check("sessions of N servers over N times those of one", ">= 0.95", round(worst, 3), worst >= 0.95)]
    if lost is not None:
        ok = lost["share_on_time"] >= 0.95
        checks.append(check("references in time over a server's death", ">= 0.95", lost["share_on_time"], ok))
    yield summary("scale", checks, curve={str(n): sessions for n, sessions in curve.items()}, job_ms=settings.job_ms)


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
