"""Whose queue it is that stands on a link: that of connections like this one, or of somebody who keeps it full.

Connections that give way hold no more than a short queue together, however many they are. Loss-based congestion control
fills whatever buffer there is, and BBR holds up to a round trip's worth; whoever gives way to such a queue ends with
next to nothing. Copa (Arun and Balakrishnan 2018) competes where a queue has not been nearly empty for five round
trips. So does this, where a queue stands that is longer than its own kind would make; and it tries out from time to
time whether somebody else still holds it: less is sent for a moment, and a queue that shrinks by much is given way to.
"""

from __future__ import annotations

from collections import deque

from cags_protocol.delivery.round_trips import RoundTrips
from cags_protocol.events import Stance

STANDING_US = 1_000_000
"""A queue that was longer than its own kind's for so long is somebody else's."""

AGAIN_US, STANDING_AGAIN_US = 15_000_000, 400_000
"""Who competed so long ago at most believes sooner that a queue is another's again: BBR empties its own for a moment
every ten seconds.
"""

PATH_US = 30_000_000
"""The shortest round trip is taken over so long: a rival may hold a queue for longer than others look back."""

COMPETING_US = 4_000_000
"""For how long, until it is tried out."""

TRIAL_US = 400_000
"""How long less is sent, besides the round trip that it takes to see what comes of it."""

SHRUNK = 0.5
"""A queue that falls to less than this share of what stood was held up by connections that give way."""

LONGEST_US = 600_000
"""A longer queue is not competed with: what waits in it is too old, and it is rather a link that has fallen."""

LOWEST_US = TRIAL_US // 2
"""The shortest queue of so long counts: single packets wait for others that were lost."""


class Competition:
    """Chooses the stance of one connection by its round trips. Times in whole microseconds of one clock."""

    def __init__(self) -> None:
        self.stance = Stance.GIVE_WAY
        self._path = RoundTrips(PATH_US)
        self._queues: deque[tuple[int, int]] = deque()  # (time, queue), rising queue: the front is the shortest
        self._short_us: int | None = None  # when the queue was short last
        self._until_us = self._stood_us = 0
        self._competed_us = -AGAIN_US

    def note(self, now_us: int, rtt_us: int, own_us: float, *, sure_us: float = 0.0) -> None:
        """A packet's round trip was ``rtt_us``; connections of this kind add ``own_us`` to it at most as a rule.

        Where they may add up to ``sure_us``, a shorter queue is tried out before it is competed with.
        """
        self._path.note(now_us, rtt_us)
        lowest_us = self._lowest(now_us, rtt_us - self._path.shortest_us)
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

    def _lowest(self, now_us: int, queue_us: int) -> int:
        while self._queues and self._queues[-1][1] >= queue_us:
            self._queues.pop()
        self._queues.append((now_us, queue_us))
        while self._queues[0][0] < now_us - LOWEST_US:
            self._queues.popleft()
        return self._queues[0][1]

    def _give_way(self, now_us: int) -> None:
        self.stance, self._short_us = Stance.GIVE_WAY, now_us

    def _try(self, now_us: int, rtt_us: int, lowest_us: int) -> None:
        self.stance, self._until_us, self._stood_us = Stance.TRY, now_us + rtt_us + TRIAL_US, lowest_us

    def _compete(self, now_us: int) -> None:
        self.stance, self._until_us = Stance.COMPETE, now_us + COMPETING_US
        self._competed_us = now_us
