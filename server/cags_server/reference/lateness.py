"""Whether a client's references come in time, and what is spared while they do not.

A difference needs the mirror, which costs as much as the truth, and is right only for a client that shows it in time.
Where references often come late they are pictures, made without the mirror; it is taken up again once they have come in
time for a while. Each time that this was too soon doubles the while, so that a machine at the edge does not go to and
fro.
"""

from __future__ import annotations

WINDOW = 8
"""References over which lateness is looked at."""

OFTEN, SELDOM = 0.4, 0.1
"""Shares of late references from which on there is no comparison, and up to which they count as in time."""

PATIENCE, MOST_PATIENCE = 60, 1920
"""References that come in time, one after the other, before comparisons begin again: at first, and at most."""


class Lateness:
    """Keeps track of how often one client's references come late."""

    def __init__(self) -> None:
        self.often = False
        """Whether they come late so often that nothing is compared."""
        self._share = 0.0
        self._in_time = 0
        self._patience, self._resumed = PATIENCE, MOST_PATIENCE

    def observe(self, *, late: bool) -> None:
        """A reference will come ``late``, or in time."""
        self._share += (late - self._share) / WINDOW
        self._in_time = 0 if late else self._in_time + 1
        self._resumed += 1
        if not self.often and self._share > OFTEN:
            hasty = self._resumed < 2 * self._patience
            self._patience = min(2 * self._patience, MOST_PATIENCE) if hasty else PATIENCE
            self.often = True
        elif self.often and self._share < SELDOM and self._in_time >= self._patience:
            self.often, self._resumed = False, 0
