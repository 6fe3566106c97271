"""What a session is short of, by its last frames: said on the operator's page, in the metrics, and in the log."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice

from cags_server.records import FrameRecord, StreamStats

RECENT_FRAMES = 60
"""Frames that tell what a session is short of."""

MANY_SKIPPED, MANY_LATE, FULL_BUDGET = 0.25, 0.25, 0.8
"""Share of frames that were skipped, of frames whose reference was late or left out, and of the byte budget that is
spent, from which on the processor, the renderer or the link is short.
"""

NOTHING, PROCESSOR, RENDERER, LINK = "nothing", "processor", "renderer", "link"
RESOURCES = (PROCESSOR, RENDERER, LINK)

LOOK_EVERY_S = 2.0
"""Time between two looks for the log."""


@dataclass(frozen=True)
class Shortage:
    """The scarcest resource of a session."""

    of: str
    """One of :data:`RESOURCES`, or :data:`NOTHING`."""
    share: float = 0.0
    """Of frames or bytes, as the sentence says; in [0, 1]."""

    def __str__(self) -> str:
        """A sentence."""
        share = f"{100 * self.share:.0f} %"
        return {
            NOTHING: "nothing",
            PROCESSOR: f"processor: the server skips {share} of the frames, being late",
            RENDERER: f"renderer: {share} of the references are late or left out",
            LINK: f"link: tiles take {share} of its bytes",
        }[self.of]


def shortage(stats: StreamStats) -> Shortage:
    """What keeps a session from more, by its last frames. The processor is named before the renderer, that before the
    link: a server that is late leaves a link idle, too.
    """
    recent = list(islice(reversed(stats.records), RECENT_FRAMES))
    if not recent:
        return Shortage(NOTHING)
    for found in (_skipped(recent), _unreferenced(recent), _spent(recent)):
        if found is not None:
            return found
    return Shortage(NOTHING)


def _skipped(recent: list[FrameRecord]) -> Shortage | None:
    covered = sum(record.ticks_covered for record in recent)
    share = 1.0 - len(recent) / max(covered, 1)
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


class ShortageLog:
    """Writes a line when a session becomes short of processor or renderer, and when it no longer is.

    A slow link is the viewer's affair, and is not logged.
    """

    def __init__(self, log: logging.Logger, name: str, clock: Callable[[], float]) -> None:
        """``clock``: seconds."""
        self._log, self._name, self._clock = log, name, clock
        self._next_s = 0.0
        self._short_of = NOTHING

    def look(self, stats: StreamStats) -> None:
        """Look at a session's figures; nothing is done before :data:`LOOK_EVERY_S` have passed since the last look."""
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
