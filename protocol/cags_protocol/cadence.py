"""Which media frames a client displays that cannot draw them all: evenly spread, and known to both sides.

A client that displays ``permille`` of 1,000 media frames counts them from the frame of its newest
:class:`~cags_protocol.wire.messages.Control` on, which is number 0, through every loop. The frames at which the running
sum of shares passes a whole number are displayed (Bresenham's line): at 600, numbers 0, 2, 4, 5, 7, 9, 10, ... A server
that knows the number looks at those frames alone, so that each has a reference of its own and none is drawn for nobody.
"""

from __future__ import annotations

EVERY_FRAME = 1000
"""All media frames are displayed."""

LEAST_PERMILLE = 250
"""The fewest that are counted with: frames planned further apart would hold up detail."""


def next_displayed(number: int, permille: int) -> int:
    """The first frame that is displayed from ``number`` on."""
    level = (number - 1) * permille // EVERY_FRAME + 1
    return -(-level * EVERY_FRAME // permille)


def last_displayed(number: int, permille: int) -> int:
    """The last frame that is displayed up to ``number``, which is not negative."""
    level = number * permille // EVERY_FRAME
    return -(-level * EVERY_FRAME // permille)
