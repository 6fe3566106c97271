"""What one client holds, and what is on its way."""

import pytest

from cags_protocol.wire.messages import TileLayers
from cags_server.visibility.inventory import ClientInventory


def layers(first: int, end: int, tile: int = 2, frame: int = 1) -> TileLayers:
    return TileLayers(frame, tile, first, end, (1,) * (end - first), (0,) * (end - first))


def test_depth_counts_layers_held_or_on_their_way() -> None:
    inventory = ClientInventory()
    assert inventory.depth(1, 2) == 0
    inventory.queued(layers(0, 1))
    inventory.queued(layers(1, 4))
    assert (inventory.depth(1, 2), inventory.delivered_depth(1, 2)) == (4, 0)
    inventory.delivered(layers(0, 1))
    assert inventory.delivered_depth(1, 2) == 1


def test_dropped_layers_leave_a_gap_that_is_filled_again() -> None:
    inventory = ClientInventory()
    for first, end in ((0, 1), (1, 3), (3, 5)):
        inventory.queued(layers(first, end))
    inventory.delivered(layers(0, 1))
    inventory.delivered(layers(3, 5))
    inventory.dropped(layers(1, 3))
    assert inventory.depth(1, 2) == 1
    assert inventory.holds(1, 2, 4)
    inventory.queued(layers(1, 3))
    assert inventory.depth(1, 2) == 5


def test_evictions_and_forgetting() -> None:
    inventory = ClientInventory()
    inventory.delivered(layers(0, 6))
    inventory.delivered(layers(0, 6, frame=9))
    inventory.reduced(1, 2, 2)
    inventory.reduced(5, 5, 0)  # never held: nothing happens
    assert inventory.depth(1, 2) == 2
    inventory.forget_before(5)
    assert (inventory.depth(1, 2), inventory.depth(9, 2)) == (0, 6)
    inventory.clear()
    assert len(inventory) == 0


@pytest.mark.parametrize("mask_of", [(0,), (0, 1), (0, 2), (1,)])
def test_runs_are_counted_from_lod_zero(mask_of: tuple[int, ...]) -> None:
    inventory = ClientInventory()
    for lod in mask_of:
        inventory.delivered(layers(lod, lod + 1))
    expected = next(lod for lod in range(9) if lod not in mask_of)
    assert inventory.depth(1, 2) == expected
