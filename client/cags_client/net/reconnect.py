"""When a connection is opened again: at once first, then ever more seldom, until patience ends. No clock.

Before the first session there is nothing to take up: each server is asked once.
"""

from __future__ import annotations

import random

FIRST_DELAY_US, MAX_DELAY_US, GROWTH = 50_000, 1_000_000, 1.5
"""Wait after the first failed attempt, the longest wait, and what each failure multiplies it by."""

JITTER = 0.25
"""Share by which a wait is shortened at random, so that the clients of a fallen server do not come back in step."""


LASTING_US = 2_000_000
"""A session that ends sooner was none: a server that lets in and hangs up is not asked again at once."""


class Reconnect:
    """The attempts after one loss. Times are the client's clock."""

    def __init__(self, patience_us: int, rng: random.Random, others: int = 0) -> None:
        """Attempts go on for ``patience_us`` after a loss; 0: there are none. Before the first session (the first
        :meth:`restored`) there is one attempt, at once, for each of ``others``, the servers not asked yet.
        """
        self.attempts = 0
        """Attempts since a connection that lasted was lost."""
        self._patience_us, self._rng, self._others = patience_us, rng, others
        self._joined = False
        self._lost_us: int | None = None
        self._restored_us: int | None = None
        self._due_us: int | None = None  # None while connected and while an attempt is under way

    @property
    def possible(self) -> bool:
        """Whether there is another attempt after a loss now."""
        return self._patience_us > 0 if self._joined else self._others > 0

    @property
    def away(self) -> bool:
        """Whether there is no session."""
        return self._lost_us is not None

    @property
    def trying(self) -> bool:
        """Whether an attempt is under way."""
        return self.away and self._due_us is None

    def lost(self, now_us: int) -> None:
        """The connection is gone, or the attempt under way has failed."""
        if self._lost_us is None:
            self._lost_us = now_us
            if self._restored_us is None or now_us - self._restored_us >= LASTING_US:
                self.attempts = 0
        at_once = self.attempts == 0 or not self._joined
        delay_us = 0.0 if at_once else FIRST_DELAY_US * GROWTH ** (self.attempts - 1)
        self._due_us = now_us + round(min(delay_us, MAX_DELAY_US) * (1 - JITTER * self._rng.random()))

    def begin(self, now_us: int) -> bool:
        """Whether an attempt is to be made now; it is under way then."""
        if self._due_us is None or now_us < self._due_us:
            return False
        self._due_us = None
        self.attempts += 1
        self._others -= not self._joined
        return True

    def restored(self, now_us: int) -> None:
        """There is a session: the first one, or it goes on."""
        self._joined = True
        self._lost_us = self._due_us = None
        self._restored_us = now_us

    def expired(self, now_us: int) -> bool:
        """Whether patience has ended."""
        return self._joined and self._lost_us is not None and now_us - self._lost_us >= self._patience_us

    def next_timer_us(self) -> int | None:
        """When an attempt is due or patience ends; None while connected."""
        if self._lost_us is None or not self._joined:
            return self._due_us
        end_us = self._lost_us + self._patience_us
        return end_us if self._due_us is None else min(self._due_us, end_us)
