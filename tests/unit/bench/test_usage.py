"""What counts as a byte that served no picture."""

from types import SimpleNamespace

import pytest

from cags_bench.sim.usage import Usage
from cags_common.geometry import Pose
from cags_protocol import events as ev
from cags_protocol.wire.messages import ReferenceFrame, TileLayers
from support.server_scene import CLIENT

SIZES = (100, 20, 7)


def tile(frame: int, number: int, first: int = 0, end: int = 3) -> ev.TileReceived:
    sizes = SIZES[first:end]
    message = TileLayers(frame, number, first, end, sizes, (0,) * len(sizes))
    return ev.TileReceived(message, memoryview(bytes(sum(sizes))))


def reference(seq: int, size: int) -> ev.ReferenceReceived:
    return ev.ReferenceReceived(ReferenceFrame(0, seq, Pose.identity(), CLIENT), memoryview(bytes(size)))


def show(usage: Usage, lods: dict[tuple[int, int], int], seq: int | None = None) -> None:
    """Present a picture in which ``lods`` of tiles are seen, restored from reference ``seq``."""
    picture = None if seq is None else SimpleNamespace(seq=seq)
    usage.shown(
        SimpleNamespace(camera=None, reference=picture),  # type: ignore[arg-type]
        SimpleNamespace(visible_lods=lambda _: lods),  # type: ignore[arg-type]
    )


def test_a_layer_serves_once_its_tile_is_seen_at_that_lod_or_higher() -> None:
    usage = Usage()
    usage.arrived([tile(0, 1), tile(0, 2)])
    assert usage.wasted_bytes(0) == usage.arrived_bytes == 2 * sum(SIZES)
    show(usage, {(0, 1): 2})
    assert usage.wasted_bytes(0) == 7 + sum(SIZES), "the third layer of one tile, the whole of the other"
    show(usage, {(0, 1): 1})
    assert usage.wasted_bytes(0) == 7 + sum(SIZES), "what has served stays served"


def test_a_layer_that_comes_after_the_picture_has_not_served_it() -> None:
    usage = Usage()
    usage.arrived([tile(0, 1, 0, 1)])
    show(usage, {(0, 1): 1})
    usage.arrived([tile(0, 1, 1, 3)])
    assert usage.wasted_bytes(0) == 27


def test_what_comes_twice_is_wasted_the_second_time() -> None:
    usage = Usage()
    usage.arrived([tile(0, 1), tile(0, 1, 1, 2)])
    show(usage, {(0, 1): 3})
    assert usage.wasted_bytes(0) == 20


def test_a_reference_serves_once_a_frame_was_restored_from_it() -> None:
    usage = Usage()
    usage.arrived([reference(1, 500), reference(2, 300)])
    show(usage, {}, seq=2)
    assert usage.wasted_bytes(0) == 500


def test_numbers_that_begin_again_name_other_references() -> None:
    """Another session counts its references from 1 again."""
    usage = Usage()
    usage.arrived([reference(1, 500)])
    show(usage, {}, seq=1)
    usage.arrived([reference(1, 300)])
    assert usage.wasted_bytes(0) == 300


@pytest.mark.parametrize("dropped", [0, 1234])
def test_what_was_dropped_half_sent_is_wasted(dropped: int) -> None:
    assert Usage().wasted_bytes(dropped) == dropped
