"""The messages of chosen tiles: what a frame waits for, and what comes at once."""

from __future__ import annotations

from dataclasses import replace

import pytest

from cags_protocol.wire.messages import FrameEnd, TileLayers
from cags_server.ratecontrol import Upgrade
from cags_server.ratecontrol.priorities import BASE_PRIORITY, ENHANCEMENT_PRIORITY, URGENT_PRIORITY
from cags_server.scene.visible_tiles import VisibleTile
from cags_server.session.tile_sender import TileSender
from support.server_scene import library


def sent(*upgrades: Upgrade) -> list[tuple[object, ...]]:
    out = TileSender(library(), opening=False).upgrades(1, upgrades, 0)
    found: list[tuple[object, ...]] = []
    for each in out:
        message = each.message
        if isinstance(message, FrameEnd):
            found.append(("end", message.frame))
        else:
            assert isinstance(message, TileLayers)
            found.append((message.tile, message.from_lod, message.to_lod, each.priority))
    return found


def test_a_base_layer_goes_before_the_end_of_its_frame_and_its_detail_after() -> None:
    assert sent(Upgrade(1, 0, 0, 3)) == [
        ("end", 0),
        (0, 0, 1, BASE_PRIORITY),
        ("end", 1),
        (0, 1, 3, ENHANCEMENT_PRIORITY),
    ]


def test_levels_that_come_together_are_one_message_that_no_frame_waits_for() -> None:
    assert sent(Upgrade(1, 0, 0, 3, together=2), Upgrade(0, 1, 0, 1)) == [
        (1, 0, 1, BASE_PRIORITY),
        ("end", 0),
        ("end", 1),
        (0, 0, 2, URGENT_PRIORITY),
        (0, 2, 3, ENHANCEMENT_PRIORITY),
    ]


def test_a_tile_of_which_all_is_held_beyond_a_gap_without_bytes_is_complete(monkeypatch: pytest.MonkeyPatch) -> None:
    """It was planned again in every frame, for nothing, and took the room of a message."""
    served = library()
    entry = served.entry(0)
    tile = replace(entry.tiles[0], lod_bytes=(10, 0, 5, 7))
    monkeypatch.setattr(served, "entry", lambda frame: replace(entry, tiles=(tile,)))
    sender = TileSender(served, opening=False)
    sender.inventory.queued(TileLayers(0, 0, 0, 1, (10,), (0,)))
    seen = VisibleTile(0, 0, 5, 1.0, 1.0)
    assert (sender.view(seen, 0, 1.0).depth, sender.view(seen, 0, 1.0).complete) == (2, False)
    sender.inventory.queued(TileLayers(0, 0, 2, 4, (5, 7), (0, 0)))
    assert sender.view(seen, 0, 1.0).complete
