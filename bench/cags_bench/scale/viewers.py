"""What viewers cost one server: whole sessions with the closed loop, by processor time, in virtual time.

Viewers of one server share what it has decoded of the bundle for their mirrors and what it has loaded of the scene for
their references; a mirror's own state, and the references themselves, each has for itself. Three ways to watch are
played in turns, so that what else the machine does meets all of them: the same moment (most is shared), moments apart
(each is elsewhere in the clip), and nothing shared (a server for each).

Processor time over all threads stands for the machine, because it depends little on what else runs there, and wall time
does. Reading from and writing to sockets, TLS and the event loop are not in it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

from cags_bench.sim.bundle import open_bundle
from cags_bench.sim.session import Scenario, SessionResult, simulate_together
from cags_client.settings import ClientSettings
from cags_common.errors import ConfigError
from cags_common.tiles.kinds import TileKind
from cags_server.settings import ServerSettings

SAME, APART, ALONE = "same moment", "moments apart", "nothing shared"
"""How viewers watch, from most that they share to nothing."""

APART_US = 700_000
"""From one viewer's joining to the next's, where they watch moments apart."""

SCATTERED_US = 10_000
"""The same where viewers share a processor: nobody's frames are due at another's very moment."""

NEVER = 1_000_000
"""Pictures are not restored: what clients make of them is not measured."""


@dataclass(frozen=True)
class Audience:
    """So many viewers of one bundle, each on a walk of its own over a link of its own."""

    bundle: Path
    viewers: int
    mbps: float
    sharing: str = SAME
    references: str = "auto"
    width: int = 400
    height: int = 300
    poses: str = "synthetic:walking"
    cores: int | None = None
    """Cores that the server's work shares; None: it takes no time."""

    def scenarios(self, first_seed: int) -> list[Scenario]:
        """Whose walks have the seeds from ``first_seed`` on."""
        base = Scenario(
            self.bundle,
            f"generated:steady-{self.mbps:g}",
            self.poses,
            server=ServerSettings(references=self.references),
            client=ClientSettings(width=self.width, height=self.height, threads=1),
            scored=False,
            score_every=NEVER,
        )
        return [replace(base, poses=f"{self.poses}:seed={first_seed + number}") for number in range(self.viewers)]

    def played(self, first_seed: int) -> list[SessionResult]:
        """Their sessions, to the end of the clip."""
        scenarios = self.scenarios(first_seed)
        if self.sharing == ALONE:
            return [result for scenario in scenarios for result in simulate_together([scenario])]
        apart_us = APART_US if self.sharing == APART else SCATTERED_US if self.cores else 0
        return simulate_together(scenarios, apart_us, self.cores)


@dataclass(frozen=True)
class Cost:
    """Processor time of a server for a second that one viewer watches, milliseconds.

    Counted from the display of a viewer's first frame to the last job that it causes: what joining takes comes once.
    """

    truth_ms: float
    mirror_ms: float
    coding_ms: float
    serving_ms: float
    jobs: float
    """References, and drawings that tell what is visible, in that second."""
    mirror_mb: float
    """Largest mirror of a viewer."""
    missed: int
    """Frames, of all viewers, whose data had not come at their display."""

    @property
    def total_ms(self) -> float:
        """Sum of all parts."""
        return self.truth_ms + self.mirror_ms + self.coding_ms + self.serving_ms

    @property
    def job_ms(self) -> float:
        """All of it over the jobs."""
        return self.total_ms / self.jobs if self.jobs else self.total_ms


def cost_of(results: Sequence[SessionResult]) -> Cost:
    """Cost of sessions. Raises :class:`ConfigError` where they were too short to say."""
    accounts = [(result.spent, result.spent.playing) for result in results]
    seconds = sum((spent.last_job_us - playing.began_us) / 1e6 for spent, playing in accounts if playing)
    if seconds <= 0:
        raise ConfigError("clip_frames: the clip ends before a viewer costs anything; give more frames")
    jobs = [job for spent, playing in accounts if playing for job in spent.references[playing.references :]]
    return Cost(
        truth_ms=sum(job.truth_ms for job in jobs) / seconds,
        mirror_ms=sum(job.mirror_ms for job in jobs) / seconds,
        coding_ms=sum(job.coding_ms for job in jobs) / seconds,
        serving_ms=sum(spent.serving_ms - playing.serving_ms for spent, playing in accounts if playing) / seconds,
        jobs=len(jobs) / seconds,
        mirror_mb=max(spent.mirror_bytes for spent, _ in accounts) / 1e6,
        missed=sum(result.summary["frames_missed"] for result in results),
    )


def measured(audiences: Sequence[Audience], rounds: int, seed: int) -> dict[Audience, list[Cost]]:
    """Costs of each audience, a round after the other and in turns within each; every round has walks of its own."""
    costs: dict[Audience, list[Cost]] = {audience: [] for audience in audiences}
    for number in range(rounds):
        for audience in audiences:
            costs[audience].append(cost_of(audience.played(seed + number * audience.viewers)))
    return costs


def lines_of(costs: dict[Audience, list[Cost]], splats: int, headroom: float) -> Iterator[dict[str, Any]]:
    """A line an audience: medians over rounds, and lowest and highest sum."""
    for audience, rounds in costs.items():
        sums = [cost.total_ms for cost in rounds]
        yield {
            "case": "viewers",
            "splats": splats,
            "references": audience.references,
            "sharing": audience.sharing,
            "viewers": audience.viewers,
            "mbps": audience.mbps,
            "rounds": len(rounds),
            **{
                name: round(median(getattr(cost, name) for cost in rounds), 2)
                for name in ("truth_ms", "mirror_ms", "coding_ms", "serving_ms", "job_ms", "jobs", "mirror_mb")
            },
            "cpu_ms": round(median(sums), 1),
            "cpu_ms_range": [round(min(sums), 1), round(max(sums), 1)],
            "missed": sum(cost.missed for cost in rounds),
            "viewers_a_core": round(headroom * 1e3 / median(sums), 2),
        }


def splats_shown(bundle: Path) -> int:
    """Splats of a bundle's first frame; tiles that only move them are not counted."""
    with open_bundle(bundle) as reader:
        return sum(tile.splats for tile in reader.frame(0).tiles if tile.kind is TileKind.LOOKS)
