"""Admission to the renderer: which clients' references are rendered when there are more than it can render.

A reference that waits too long arrives too late to be used, and costs as much as one in time. Therefore only as many
are admitted as the workers finish within the time that the next one can wait. A client without a place plans its frame
by the tiles that it last saw. Places go by *served time*: each reference adds to its client's account, less where the
client lacks much. While a client that was turned away is waiting, clients a turn ahead of it are turned away too. Near
full load this leaves workers idle for up to a fifth of the time.

When the renderer is busy all the time, references of all clients are coded *lightly* (:mod:`.coder`) until the time
that careful ones take would fit again.
"""

from __future__ import annotations

import math

from cags_server.reference.coder import INVISIBLE

LEAST_PLACES = 2
"""Fewest places per worker, however long references take: one being rendered and one queued behind it."""

PATIENCE_US = 500_000
"""A client that was turned away and has not asked again for so long no longer holds others back."""

LEAST_DB, MOST_DB = 3.0, 12.0
"""Bounds of what a client lacks, in decibels above the invisible."""

TURNS_AHEAD = 2
"""Lead in turns over a waiting client at which a client is turned away while a worker is idle; otherwise it is one."""

LOOK = 1 / 6
"""Cost of a render for visibility alone, in references: a quarter of the pixels, no mirror and no coding."""

BUSY, ROOMY = 0.9, 0.7
"""Shares of the workers' time: above the first, references become light; below the second, careful ones would fit."""

SMOOTHING_US, SMOOTHING = 2e6, 0.1
"""Time constant of the busy share, and weight of the newest reference in the mean time per reference."""

LEAST_STAY_US = 5_000_000
"""Shortest time between light and careful coding: each change restarts every client's video."""


class RenderSlots:
    """The places of one renderer, shared by all its clients. Times are microseconds of the server's clock."""

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self._out = 0
        self._served: dict[str, float] = {}  # account of each client, in references that count fully
        self._turns: dict[str, float] = {}  # what the next reference of a client that was turned away will add
        self._turned_away: dict[str, int] = {}  # client -> when it last asked in vain
        self._took_us = {False: 0.0, True: 0.0}  # a careful one, a light one; 0: not known
        self._busy, self._noted_us = 0.0, 0
        self._changed_us: int | None = None
        self.light = False
        """Whether references are to be coded lightly."""

    def places(self, wait_us: float) -> int:
        """References that may be out at a time, for one more to wait for ``wait_us`` at most."""
        took_us = self._took_us[self.light]
        behind = int(wait_us / took_us) if took_us else 0
        return self._workers * max(LEAST_PLACES, 1 + behind)

    def may(self, name: str, now_us: int, wait_us: float = 0.0, lacking: float | None = None) -> bool:
        """Whether a client may have a reference rendered now, that can wait ``wait_us`` for a worker. ``lacking``: mean
        squared error of what it showed when that was last compared, [0, 1] RGB; None: not known.
        """
        self._note(now_us)
        again, turn = name in self._turned_away, _turn(lacking)
        waiting = [other for other, at in self._turned_away.items() if other != name and at >= now_us - PATIENCE_US]
        mine = self._served.setdefault(name, 0.0)
        if not again and waiting:  # time in which nobody asked gives no credit
            mine = self._served[name] = max(mine, min(self._served[other] for other in waiting))
        turns = TURNS_AHEAD if self._out < self._workers else 1  # rather than that a worker stands idle
        ahead = any(mine >= self._served[other] + turns * self._turns[other] for other in waiting)
        if not ahead and self._out < self.places(wait_us) + (self._workers if again else 0):
            return True
        self._turned_away[name], self._turns[name] = now_us, turn
        return False

    def begun(self, name: str, now_us: int, lacking: float | None = None, *, look: bool = False) -> None:
        """A client's reference, or a ``look`` at what is seen, is being rendered, or waits for a worker."""
        self._note(now_us)
        self._out += 1
        self._served[name] = self._served.get(name, 0.0) + (LOOK if look else _turn(lacking))
        self._turned_away.pop(name, None)

    def ended(self, now_us: int, took_us: float | None = None, *, light: bool = False) -> None:
        """A reference that was coded so took a worker ``took_us``; None: it was given up."""
        self._note(now_us)
        self._out -= 1
        if took_us is not None:
            known_us = self._took_us[light]
            self._took_us[light] = known_us + SMOOTHING * (took_us - known_us) if known_us else took_us

    def left(self, name: str) -> None:
        """A client is gone."""
        for known in (self._turned_away, self._served, self._turns):
            known.pop(name, None)

    def _note(self, now_us: int) -> None:
        """Take in the time since the last call, and decide how carefully references are coded."""
        passed_us = max(now_us - self._noted_us, 0)
        self._noted_us = max(now_us, self._noted_us)
        busy = min(self._out, self._workers) / self._workers
        self._busy += (busy - self._busy) * (1 - math.exp(-passed_us / SMOOTHING_US))
        if self._changed_us is not None and now_us - self._changed_us < LEAST_STAY_US:
            return
        careful_us, light_us = self._took_us[False], self._took_us[True]
        if self.light:
            change = bool(light_us) and self._busy * careful_us / light_us < ROOMY
        else:
            change = self._busy > BUSY and len(self._served) > self._workers
        if change:
            self.light, self._changed_us = not self.light, now_us


def _turn(lacking: float | None) -> float:
    """What a reference adds to the account of a client that lacks so much."""
    if lacking is None:
        return 1.0
    db = 10 * math.log10(max(lacking, INVISIBLE) / INVISIBLE)
    return MOST_DB / min(max(db, LEAST_DB), MOST_DB)
