"""Which resource limits a session, judged by its last frames; for the operator's page, the metrics and the log."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection
from dataclasses import dataclass
from itertools import islice

from cags_server.records import RECENT_FRAMES, FrameRecord, StreamStats

MANY_SKIPPED, MANY_LATE, FULL_BUDGET = 0.25, 0.25, 0.8
"""Limits beyond which processor, renderer and link are short: share of skipped frames, share of frames whose reference
was late or left out, and share of the byte budget that is spent. The link is short, too, where such a share of the
frames comes late for no other reason: over long delays.
"""

NOTHING, PROCESSOR, RENDERER, LINK = "nothing", "processor", "renderer", "link"
RESOURCES = (PROCESSOR, RENDERER, LINK)

LOOK_EVERY_S = 2.0
"""Interval between checks for the log."""


@dataclass(frozen=True)
class Shortage:
    """The scarcest resource of a session."""

    of: str
    """One of :data:`RESOURCES`, or :data:`NOTHING`."""
    share: float = 0.0
    """Share of frames or bytes, as in the sentence; in [0, 1]."""
    late: bool = False
    """Of a link: it takes too long, whatever it carries."""

    def __str__(self) -> str:
        """A sentence."""
        share = f"{100 * self.share:.0f} %"
        return {
            NOTHING: "nothing",
            PROCESSOR: f"processor: the server skips {share} of the frames, being late",
            RENDERER: f"renderer: {share} of the references are late or left out",
            LINK: f"link: {share} of the frames come late" if self.late else f"link: tiles take {share} of its bytes",
        }[self.of]


def shortage(stats: StreamStats) -> Shortage:
    """The resource that limits a session. The processor takes precedence over the renderer, and the renderer over the
    link, because a late server also leaves the link idle.
    """
    recent = list(islice(reversed(stats.records), RECENT_FRAMES))
    if not recent:
        return Shortage(NOTHING)
    for found in (_skipped(recent), _unreferenced(recent), _spent(recent), _late(stats.lately)):
        if found is not None:
            return found
    return Shortage(NOTHING)


def _skipped(recent: list[FrameRecord]) -> Shortage | None:
    skipped = sum(record.skipped for record in recent)
    share = skipped / (skipped + len(recent))
    return Shortage(PROCESSOR, share) if share > MANY_SKIPPED else None


def _unreferenced(recent: list[FrameRecord]) -> Shortage | None:
    share = sum(record.reference_late or record.no_place for record in recent) / len(recent)
    return Shortage(RENDERER, share) if share > MANY_LATE else None


def _spent(recent: list[FrameRecord]) -> Shortage | None:
    budget = sum(max(record.budget_bytes, 0) for record in recent)
    spent = sum(record.tile_bytes for record in recent)
    if not spent or spent < FULL_BUDGET * budget:
        return None
    return Shortage(LINK, min(spent / max(budget, 1), 1.0))


def _late(lately: Collection[bool]) -> Shortage | None:
    share = sum(lately) / max(len(lately), 1)
    return Shortage(LINK, share, late=True) if share > MANY_LATE else None


class ShortageLog:
    """Logs when a session becomes short of processor or renderer, and when the shortage ends.

    Slow links are not logged: an operator cannot change them.
    """

    def __init__(self, log: logging.Logger, name: str, clock: Callable[[], float]) -> None:
        """``clock``: seconds."""
        self._log, self._name, self._clock = log, name, clock
        self._next_s = 0.0
        self._short_of = NOTHING

    def look(self, stats: StreamStats) -> None:
        """Check a session, at most once every :data:`LOOK_EVERY_S`."""
        if self._clock() < self._next_s:
            return
        self._next_s = self._clock() + LOOK_EVERY_S
        found = shortage(stats)
        now = found.of if found.of in (PROCESSOR, RENDERER) else NOTHING
        if now == self._short_of:
            return
        if now != NOTHING:
            self._log.warning("%s: short of %s", self._name, found)
        else:
            self._log.info("%s: no longer short of %s", self._name, self._short_of)
        self._short_of = now
