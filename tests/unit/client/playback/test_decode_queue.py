"""Media between the wire and its decoder."""

from __future__ import annotations

from cags_client.playback.decode_queue import DECODE_BATCH, DecodeQueue
from cags_client.playback.jobs import Restarted, Traffic
from cags_common.geometry import Intrinsics, Pose
from cags_common.tiles.inventory import InventoryEntry
from cags_protocol import events as ev
from cags_protocol.wire.messages import Mark, ReferenceFrame, TileLayers


def tile(number: int, from_lod: int = 0, to_lod: int = 1, size: int = 10) -> ev.TileReceived:
    lods = to_lod - from_lod
    message = TileLayers(0, number, from_lod, to_lod, (size // lods,) * lods, (0,) * lods)
    return ev.TileReceived(message, memoryview(bytes(size)))


def reference(size: int) -> ev.ReferenceReceived:
    message = ReferenceFrame(0, 1, Pose.identity(), Intrinsics.of_fov(40, 30, 0.5, 0.4))
    return ev.ReferenceReceived(message, memoryview(bytes(size)))


def test_batches_come_in_order_one_at_a_time() -> None:
    arrivals = DecodeQueue()
    events = [tile(number) for number in range(DECODE_BATCH + 1)]
    for event in events:
        arrivals.add(event)
    assert arrivals.take() == tuple(events[:-1])
    assert arrivals.take() == () == arrivals.take(), "one batch is out"
    assert arrivals.decoding == tuple(events[:-1])
    arrivals.decoded()
    assert arrivals.take() == (events[-1],)
    arrivals.decoded()
    assert arrivals.take() == ()


def test_before_tiles_can_be_decoded_what_comes_before_them_is() -> None:
    arrivals = DecodeQueue()
    first, later = reference(7), reference(8)
    for event in (first, tile(0), later):
        arrivals.add(event)
    assert arrivals.take(tiles=False) == (first,)
    arrivals.decoded()
    assert arrivals.take(tiles=False) == (), "the order stays"
    arrivals.decoded()
    assert len(arrivals.take()) == 2


def test_traffic_is_counted_once_and_survives_decoding() -> None:
    arrivals = DecodeQueue()
    assert arrivals.quiet
    arrivals.add(tile(0, size=30))
    arrivals.add(reference(7))
    arrivals.take()
    assert not arrivals.quiet
    assert arrivals.traffic() == Traffic(30, 7)
    assert arrivals.quiet
    assert arrivals.traffic() == Traffic(0, 0)


def test_a_mark_alone_is_news_too() -> None:
    """It may show what has come before."""
    arrivals = DecodeQueue()
    arrivals.add(ev.MarkReceived(Mark(1)))
    assert not arrivals.quiet
    assert arrivals.traffic() == Traffic(0, 0)
    assert arrivals.quiet


def test_the_beginning_of_a_connection_outlives_a_jump() -> None:
    arrivals, begins = DecodeQueue(), Restarted()
    for event in (tile(0), begins, tile(1)):
        arrivals.add(event)
    arrivals.clear()
    assert arrivals.undecoded_bytes == 0
    assert arrivals.take() == (begins,)


def test_what_waits_and_what_is_being_decoded_counts_as_held() -> None:
    arrivals = DecodeQueue()
    arrivals.add(tile(1, 0, 1))
    arrivals.take()
    arrivals.add(tile(1, 1, 3, size=20))
    arrivals.add(tile(2, 1, 2))  # its base was lost with the connection: nothing can be made of it
    stored = [InventoryEntry(0, 3, 4)]
    assert set(arrivals.held(stored)) == {InventoryEntry(0, 1, 3), InventoryEntry(0, 3, 4)}
    arrivals.clear()
    assert set(arrivals.held(stored)) == {InventoryEntry(0, 1, 1), InventoryEntry(0, 3, 4)}


def test_what_waits_and_what_is_being_decoded_is_undecoded() -> None:
    arrivals = DecodeQueue()
    for event in (tile(0, size=30), Restarted(), reference(12)):
        arrivals.add(event)
    assert arrivals.undecoded_bytes == 42
    arrivals.take()
    arrivals.add(tile(1, size=8))
    assert arrivals.undecoded_bytes == 50
    arrivals.decoded()
    assert arrivals.undecoded_bytes == 8
    arrivals.clear()
    assert arrivals.undecoded_bytes == 0
