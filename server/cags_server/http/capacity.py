"""How many viewers the renderer carries, by what references of this scene have cost so far."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass

from cags_server.records import ReferenceCosts
from cags_server.settings import ServeSettings

LEAST_MEASURED = 20
"""References before whose cost is known; until then a viewer a core is let in."""

HEADROOM = 0.8
"""Share of the cores that references may take; the rest is for planning, sending and the system."""


@dataclass(frozen=True)
class Capacity:
    """What a machine carries."""

    clients: int
    reference_ms: float | None
    """Core time of a reference; None before it is known."""

    def reason(self) -> str:
        """Why one more is refused, with the figures."""
        if self.reference_ms is None:
            return f"{self.clients} clients are here and what one costs is not known yet; try again in a few seconds"
        return (
            f"this machine carries {self.clients} viewers of this scene (a reference takes {self.reference_ms:.1f} ms "
            "of a core), and they are here; try again later"
        )


def capacity(
    settings: ServeSettings,
    fps: float,
    costs: Iterable[tuple[ReferenceCosts, ReferenceCosts]],
    cores: int | None = None,
) -> Capacity:
    """Capacity estimated from what references took in all sessions so far: careful ones, and light ones.

    Where many watch, references are light; careful ones stand for them until there were some. ``cores`` None: those of
    this process.
    """
    cores = cores or available_cores()
    careful, light = ReferenceCosts(), ReferenceCosts()
    for one, other in costs:
        careful, light = careful + one, light + other
    known = light if light.references >= LEAST_MEASURED else careful
    if known.references < LEAST_MEASURED:
        return Capacity(cores, None)
    threads = min(settings.render_threads, cores)
    reference_s = (known.render_ns * threads + known.encode_ns) / known.references / 1e9
    usable = HEADROOM * min(cores, settings.workers * threads)
    return Capacity(max(1, int(usable / (reference_s * fps / settings.reference_every))), reference_s * 1e3)


def available_cores() -> int:
    """Cores that this process may run on."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not Linux
        return os.cpu_count() or 1
