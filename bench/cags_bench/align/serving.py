"""The server's cost of a reference, for one client and for several clients of one scene."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from statistics import median

from cags_bench.align.settings import AlignBenchSettings
from cags_bench.jsonl import JsonObject, provenance
from cags_bench.sim.session import Scenario, simulate_together
from cags_bench.traces import paper_link
from cags_client.settings import ClientSettings
from cags_server.settings import ServerSettings

CLIENT_PX = (400, 300)
"""Size of the clients' pictures, which are not looked at."""


def serving_line(bundle: Path, clients: int, settings: AlignBenchSettings) -> JsonObject:
    """Play ``bundle`` to several clients of one server, each on its own walk."""
    base = Scenario(
        bundle,
        paper_link(bundle, settings.link_mbps),
        settings.poses,
        server=ServerSettings(render_threads=settings.threads),
        client=ClientSettings(width=CLIENT_PX[0], height=CLIENT_PX[1], threads=settings.threads),
        scored=False,
    )
    results = simulate_together([_walking(base, number) for number in range(clients)])
    costs = [cost for result in results for cost in result.spent.references]
    parts = {
        "truth_ms": [cost.truth_ms for cost in costs],
        "mirror_ms": [cost.mirror_ms for cost in costs],
        "coding_ms": [cost.coding_ms for cost in costs],
        "processor_ms": [cost.total_ms for cost in costs],
        "ms": [cost.wall_ms for cost in costs],
    }
    return {
        "benchmark": "align",
        "part": "server",
        "clients": clients,
        "references": len(costs),
        "threads": settings.threads,
        "seed": settings.seed,
        **{name: median(values) for name, values in parts.items()},
        "processor_mean_ms": sum(parts["processor_ms"]) / max(len(costs), 1),
        "spread_ms": max(parts["ms"]) - min(parts["ms"]),
        **provenance(),
    }


def _walking(base: Scenario, number: int) -> Scenario:
    """The scenario with its own walk if walks are generated; recorded walks are shared."""
    head = base.poses.partition(":seed=")[0]
    return replace(base, poses=f"{head}:seed={number + 1}") if head.startswith("synthetic") else base
