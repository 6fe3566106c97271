"""What a client will have of a frame once what was decided has arrived."""

from __future__ import annotations

import pytest

from cags_server.ratecontrol.base import Decision, Observation, TileView, Upgrade
from cags_server.ratecontrol.outlook import Supply, supply


def seen(*depths: int, later: int | None = None) -> Observation:
    """Tiles of three levels that count at frame 5, and one that begins at frame 9."""
    tiles = [TileView(5, number, depth, 10, (100, 50, 50)) for number, depth in enumerate(depths)]
    tiles += [] if later is None else [TileView(9, 0, later, 10, (100, 50, 50))]
    return Observation(5, 1000, tuple(tiles), (), 0)


def sent(*upgrades: tuple[int, int, int]) -> Decision:
    return Decision(tuple(Upgrade(5, *upgrade) for upgrade in upgrades), 0)


@pytest.mark.parametrize(
    ("observation", "decision", "expected"),
    [
        (seen(3, 3), sent(), Supply.COMPLETE),
        (seen(3, 2), sent(), Supply.DETAIL_MISSING),
        (seen(3, 2), sent((1, 2, 3)), Supply.COMPLETE),
        (seen(3, 0), sent(), Supply.BASE_MISSING),
        (seen(3, 0), sent((1, 0, 1)), Supply.DETAIL_MISSING),
        (seen(0, 0), sent((0, 0, 3), (1, 0, 3)), Supply.COMPLETE),
        (seen(3, later=0), sent(), Supply.COMPLETE),
        (seen(), sent(), Supply.COMPLETE),
    ],
)
def test_what_is_missing_after_a_decision(observation: Observation, decision: Decision, expected: Supply) -> None:
    assert supply(observation, decision) is expected
