"""Decides whether a queue that stands on the link is our own or another flow's.

Connections that give way hold a short queue together, however many they are. Loss-based congestion control fills
whatever buffer there is, and BBR holds up to a round trip's worth; a connection that gives way to such a queue ends
with next to nothing. Copa (Arun and Balakrishnan 2018) competes when the queue has not been nearly empty for five
round trips. This one competes with a queue that stands and is longer than connections of its kind make. Now and then it
sends less for a moment: if the queue shrinks by much, nobody else holds it, and the connection gives way again.
"""

from __future__ import annotations

from cags_protocol.delivery.round_trips import Lowest
from cags_protocol.events import Stance

STANDING_US = 1_000_000
"""A queue that has been longer than connections of this kind make for so long belongs to another flow."""

AGAIN_US, STANDING_AGAIN_US = 15_000_000, 400_000
"""After a connection has competed, a shorter wait is enough for so long: BBR empties its queue for a moment every ten
seconds.
"""

PATH_US = 30_000_000
"""Window of the shortest round trip; longer than elsewhere, because a rival may hold its queue for ten seconds."""

COMPETING_US = 4_000_000
"""Time between two trials."""

TRIAL_US = 400_000
"""Length of a trial, besides the round trip after which its effect is seen."""

SHRUNK = 0.5
"""A queue that falls below this share of its length during a trial is not another flow's."""

LONGEST_US = 600_000
"""Longer queues are not competed with: the link has probably become slower, and what waits in them is too old."""

LOWEST_US = TRIAL_US // 2
"""Window of the shortest queue: single packets are late because they wait for a lost one."""


class Competition:
    """Chooses the stance of one connection by its round trips. Times in whole microseconds of one clock."""

    def __init__(self) -> None:
        self.stance = Stance.GIVE_WAY
        self._path_us, self._queue_us = Lowest(PATH_US), Lowest(LOWEST_US)
        self._short_us: int | None = None  # when the queue was short last
        self._until_us = self._stood_us = 0
        self._competed_us = -AGAIN_US

    def note(self, now_us: int, rtt_us: int, own_us: float, *, sure_us: float = 0.0) -> None:
        """A packet's round trip was ``rtt_us``. Connections of this kind usually make a queue of at most ``own_us``.

        They may make one of up to ``sure_us``; a queue between the two is tried before it is competed with.
        """
        self._path_us.note(now_us, rtt_us)
        self._queue_us.note(now_us, rtt_us - self._path_us.value)
        lowest_us = self._queue_us.value
        if self._short_us is None or not own_us < lowest_us < LONGEST_US:
            self._give_way(now_us)
        elif self.stance is Stance.GIVE_WAY:
            known = now_us - self._competed_us < AGAIN_US
            if now_us - self._short_us >= (STANDING_AGAIN_US if known else STANDING_US):
                if known or lowest_us > sure_us:
                    self._compete(now_us)
                else:
                    self._try(now_us, rtt_us, lowest_us)
        elif now_us >= self._until_us:
            if self.stance is Stance.COMPETE:
                self._try(now_us, rtt_us, lowest_us)
            elif lowest_us < SHRUNK * self._stood_us:
                self._give_way(now_us)
                self._competed_us = now_us - AGAIN_US
            else:
                self._compete(now_us)

    def _give_way(self, now_us: int) -> None:
        self.stance, self._short_us = Stance.GIVE_WAY, now_us

    def _try(self, now_us: int, rtt_us: int, lowest_us: int) -> None:
        self.stance, self._until_us, self._stood_us = Stance.TRY, now_us + rtt_us + TRIAL_US, lowest_us

    def _compete(self, now_us: int) -> None:
        self.stance, self._until_us = Stance.COMPETE, now_us + COMPETING_US
        self._competed_us = now_us
