"""A server's cost per viewer: whole sessions with references, by processor time, in virtual time.

Viewers of one server share the data that it decoded for their mirrors and the scene that it loaded for their
references. Each viewer has its own mirror state and its own references. Three kinds of audience are played alternately,
so that other load on the machine affects all: at the same moment of the clip (most is shared), at different moments,
and with nothing shared (one server each).

The measure is processor time over all threads, because it hardly depends on other load, unlike wall time. Socket
input and output, TLS and the event loop are not included.
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
"""Kinds of audience, from most sharing to none."""

APART_US = 700_000
"""Time between joining viewers if they watch different moments."""

SCATTERED_US = 10_000
"""The same if viewers share a processor: their frames are then not all due at the same moment."""

NEVER = 1_000_000
"""Interval of restored pictures; the clients' pictures are not measured."""


@dataclass(frozen=True)
class Audience:
    """Viewers of one bundle, each on its own walk over its own link."""

    bundle: Path
    viewers: int
    mbps: float
    sharing: str = SAME
    references: str = "auto"
    width: int = 400
    height: int = 300
    poses: str = "synthetic:walking"
    cores: int | None = None
    """Cores that run the server's work; None: it takes no time."""

    def scenarios(self, first_seed: int) -> list[Scenario]:
        """Scenarios whose walks have consecutive seeds from ``first_seed``."""
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
        """Play the sessions to the end of the clip."""
        scenarios = self.scenarios(first_seed)
        if self.sharing == ALONE:
            return [result for scenario in scenarios for result in simulate_together([scenario])]
        apart_us = APART_US if self.sharing == APART else SCATTERED_US if self.cores else 0
        return simulate_together(scenarios, apart_us, self.cores)


@dataclass(frozen=True)
class Cost:
    """A server's processor time per viewer and second, milliseconds.

    It is counted from a viewer's first displayed frame to its last job, without the one-time cost of joining.
    """

    truth_ms: float
    mirror_ms: float
    coding_ms: float
    serving_ms: float
    jobs: float
    """Jobs per second: references, and renders that determine what is visible."""
    mirror_mb: float
    """Largest mirror of a viewer, megabytes."""
    missed: int
    """Number of frames of all viewers whose data had not arrived when they were displayed."""

    @property
    def total_ms(self) -> float:
        """Sum of all parts."""
        return self.truth_ms + self.mirror_ms + self.coding_ms + self.serving_ms

    @property
    def job_ms(self) -> float:
        """Mean cost per job."""
        return self.total_ms / self.jobs if self.jobs else self.total_ms


def cost_of(results: Sequence[SessionResult]) -> Cost:
    """Cost of sessions. Raises :class:`ConfigError` if they were too short."""
    accounts = [(result.spent, result.spent.playing) for result in results]
    seconds = sum((spent.last_job_us - playing.began_us) / 1e6 for spent, playing in accounts if playing)
    if seconds <= 0:
        raise ConfigError("clip_frames: the clip is too short to measure a viewer's cost; give more frames")
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
    """Costs of each audience. Audiences alternate within a round; every round has its own walks."""
    costs: dict[Audience, list[Cost]] = {audience: [] for audience in audiences}
    for number in range(rounds):
        for audience in audiences:
            costs[audience].append(cost_of(audience.played(seed + number * audience.viewers)))
    return costs


def lines_of(costs: dict[Audience, list[Cost]], splats: int, headroom: float) -> Iterator[dict[str, Any]]:
    """One line per audience: medians over rounds, and the range of the sums."""
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
    """Number of splats in a bundle's first frame, without tiles of motion."""
    with open_bundle(bundle) as reader:
        return sum(tile.splats for tile in reader.frame(0).tiles if tile.kind is TileKind.LOOKS)
