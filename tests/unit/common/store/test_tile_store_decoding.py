"""Tiles that are decoded by threads, in batches, and by decoders that misbehave."""

import contextlib
import copy
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from cags_common.bundle.codecs import SvqTileCodec, TileDecoder
from cags_common.errors import DecodeError
from cags_common.motion.neighbours import Anchors
from cags_common.splats import Splats
from cags_common.store.tile_decode import Arrival
from cags_common.store.tile_store import TileStore
from support.small_store import CAPACITY, base, books, layer, manifest, removed, xs


def test_many_at_once_on_two_threads_end_as_one_by_one_and_only_the_damaged_are_left_out() -> None:
    one, two = (TileStore(manifest(), SvqTileCodec(manifest(), books().to_bytes()), threads) for threads in (1, 2))
    arrivals = [
        Arrival(0, 1, 1, [layer(2, 1)]),  # before its base
        Arrival(0, 0, 0, [base([0, 1, 2], 1), layer(3, 1)]),
        Arrival(0, 1, 0, [base([3, 4], 2)]),
        Arrival(0, 2, 0, [base([5], 3)[:-3]]),
        Arrival(0, 2, 0, [base([5], 4)]),
        Arrival(0, 3, 0, [base([CAPACITY], 5)]),
        Arrival(99, 0, 0, [base([6], 6)]),
    ]
    for arrival in arrivals:
        with contextlib.suppress(DecodeError):
            one.add(arrival.frame, arrival.tile, arrival.from_lod, arrival.payloads)
    wrong = [str(error) for error in two.add_all(arrivals)]
    assert len(wrong) == 3
    assert any("outside the group's capacity" in text for text in wrong)
    for store in (one, two):
        store.end(0, removed())
        store.flush()
    assert xs(one, 0) == xs(two, 0) == [1, 1, 1, 2, 2, 4, *[-1] * (CAPACITY - 6)]
    for (name, a), (_, b) in zip(one.commit(0)[0].splats.arrays(), two.commit(0)[0].splats.arrays(), strict=True):
        assert np.array_equal(a, b), name


class GrowingTile:
    """A tile whose second level brings a splat with an id that the group does not have."""

    def __init__(self) -> None:
        self.ids, self.lod, self.steps, self.grows = np.array([0], np.int32), 0, None, True

    @property
    def means(self) -> np.ndarray:
        return np.zeros((len(self.ids), 3), np.float32)

    def __len__(self) -> int:
        return len(self.ids)

    def add_layer(self, lod: int, payload: bytes | memoryview) -> bool:
        self.ids, self.lod = np.array([0, CAPACITY], np.int32), lod
        return True

    def fork(self) -> "GrowingTile":
        return copy.copy(self)

    def dequantise(self, into: object = None) -> Splats:
        n = len(self.ids)
        quats = np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1))
        colours = np.zeros((n, 3), np.float32)
        return Splats(self.means, quats, colours, np.zeros(n, np.float32), colours, np.zeros((n, 0, 3), np.float32))


class GrowingCodec:
    def open_tile(self, payload: bytes | memoryview, anchors: Anchors | None = None) -> GrowingTile:
        return GrowingTile()

    def tile_ids(self, payload: bytes | memoryview) -> np.ndarray:
        return np.array([0], np.int32)


def test_a_tile_that_grows_beyond_its_group_is_reported_and_does_not_end_the_display() -> None:
    store = TileStore(manifest(), GrowingCodec())
    store.add(0, 0, 0, [memoryview(b"base")])
    store.end(0, removed())
    assert xs(store, 0)[0] == 0
    store.add(0, 0, 1, [memoryview(b"more")])
    assert xs(store, 0) == [0, *[-1] * (CAPACITY - 1)]  # the display path dequantises what nobody flushed
    assert [str(error) for error in store.flush()] == [
        f"tile 0 of frame 0: id {CAPACITY} is outside the group's capacity {CAPACITY}"
    ]
    assert store.flush() == []


class OneMoreCodec(GrowingCodec):
    """Whose tiles' second level brings a further splat."""

    def open_tile(self, payload: bytes | memoryview, anchors: Anchors | None = None) -> GrowingTile:
        return OneMoreTile()


class OneMoreTile(GrowingTile):
    def add_layer(self, lod: int, payload: bytes | memoryview) -> bool:
        self.ids, self.lod, self.grows = np.array([0, 1], np.int32), lod, False
        return True


@pytest.mark.parametrize("shown_between", [False, True])
def test_a_tile_that_lost_its_splats_shows_those_that_a_later_level_brings(shown_between: bool) -> None:
    store = TileStore(manifest(), OneMoreCodec())
    for frame in range(2):
        store.add(frame, 0, 0, [memoryview(b"base")])
        store.end(frame, removed())
    if shown_between:
        store.commit(1)
    store.add(0, 0, 1, [memoryview(b"more")])
    assert xs(store, 1)[:3] == [0, 0, -1]
    gof, _ = store.commit(1)
    assert [tile.owned for tile in gof.shown.tiles] == [1, 1]


class GatedCodec(SvqTileCodec):
    """Opens tiles only once the gate is open."""

    def __init__(self) -> None:
        super().__init__(manifest(), books().to_bytes())
        self.asked, self.gate = threading.Event(), threading.Event()

    def open_tile(self, payload: bytes | memoryview, anchors: Anchors | None = None) -> TileDecoder:
        self.asked.set()
        assert self.gate.wait(10)
        return super().open_tile(payload, anchors)


def test_the_display_does_not_wait_for_a_batch_that_is_being_decoded() -> None:
    codec = GatedCodec()
    codec.gate.set()
    store = TileStore(manifest(), codec)
    store.add(0, 0, 0, [base([0], 1)])
    store.flush()
    store.end(0, removed())
    codec.gate.clear()
    codec.asked.clear()
    with ThreadPoolExecutor(2) as pool:
        decoding = pool.submit(store.add, 1, 0, 0, [base([0], 2)])
        assert codec.asked.wait(10)
        try:
            assert pool.submit(xs, store, 0).result(5)[0] == 1
            assert not decoding.done()
        finally:
            codec.gate.set()
        decoding.result(10)
    store.flush()
    store.end(1, removed())
    assert xs(store, 1)[0] == 2
