"""When a first picture is shown before all of it has come."""

from __future__ import annotations

from cags_protocol.messages import FrameEnd, TileLayers
from cags_server.opening import PATIENCE_US, Opening

KEYS = [(0, tile) for tile in range(8)]


def arrived(opening: Opening, *tiles: int) -> None:
    for tile in tiles:
        opening.settled(TileLayers(0, tile, 0, 1, (1,), (0,)))


def test_on_a_slow_link_the_play_begins_with_what_is_nearest() -> None:
    opening = Opening(5, KEYS, 1000)
    assert opening.due_us() is None, "nothing to show yet"
    arrived(opening, 0)
    assert opening.end(1000 + 10 * PATIENCE_US) == []
    arrived(opening, 1)
    assert opening.due_us() == 1000 + PATIENCE_US
    assert opening.end(1000 + PATIENCE_US - 1) == []
    assert opening.end(1000 + PATIENCE_US) == [FrameEnd(5)]
    assert opening.end(1000 + 2 * PATIENCE_US) == [], "once"
    assert opening.due_us() is None


def test_on_a_fast_link_there_is_nothing_to_do() -> None:
    opening = Opening(0, KEYS, 0)
    arrived(opening, *range(8))
    assert opening.due_us() is None
    assert opening.end(PATIENCE_US) == []


def test_nothing_in_view_waits_for_nothing() -> None:
    assert Opening(0, [], 0).due_us() is None
