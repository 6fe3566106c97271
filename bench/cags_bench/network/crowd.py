"""Many sessions under one virtual clock: processing time and memory per session."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from cags_bench.network.load import Arrivals, advance, load_world
from cags_bench.sim.world import World
from cags_server.link import MeasuredLink
from cags_shaper.link import LinkSettings
from cags_shaper.trace import open_trace

FPS = 5.0
STEP_US = 100_000


def crowd_line(sessions: int, duration_us: int, delay_us: int) -> dict[str, Any]:
    """Run ``sessions`` sessions of 5 frames per second over 2 Mbps each for ``duration_us`` of virtual time."""
    trace = open_trace("generated:steady-2")
    before = resident_bytes()
    started = time.perf_counter()
    worlds: list[tuple[World, Arrivals]] = []
    for _ in range(sessions):
        worlds.append(load_world(trace, MeasuredLink(initial_bps=2e6), LinkSettings(delay_us=delay_us), FPS))
    for now_us in range(STEP_US, duration_us + 1, STEP_US):
        for world, _ in worlds:
            advance(world, now_us)
    seconds = time.perf_counter() - started
    received = sum(len(log.tiles) + len(log.references) for _, log in worlds)
    return {
        "case": "crowd",
        "sessions": sessions,
        "virtual_s": duration_us / 1e6,
        "seconds": seconds,
        "messages": received,
        "silent_sessions": sum(not log.tiles for _, log in worlds),
        "memory_kib_per_session": (resident_bytes() - before) / 1024 / sessions,
    }


def resident_bytes() -> int:
    """Resident memory of this process in bytes (Linux); 0 elsewhere."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except OSError:
        return 0
    return pages * 4096
