"""Layers that wait for the base of their tile."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_common.store import reorder_buffer as waiting
from cags_common.store.reorder_buffer import WaitingLayers

KEYS = st.tuples(st.integers(0, 2), st.integers(0, 2))
STEPS = st.lists(st.tuples(KEYS, st.integers(1, 8), st.binary(max_size=30), st.booleans()), max_size=60)


def test_layers_come_back_in_order_and_once() -> None:
    layers = WaitingLayers()
    data = bytearray(b"abc")
    layers.add((0, 1), [(2, memoryview(data)), (1, memoryview(b"d"))])
    data[:] = b"xyz"  # the message's buffer is used again
    assert layers.bytes == 4
    assert [(lod, bytes(payload)) for lod, payload in layers.take((0, 1))] == [(2, b"abc"), (1, b"d")]
    assert layers.take((0, 1)) == []
    assert layers.bytes == 0


@given(STEPS)
def test_the_bytes_are_those_that_wait_and_bounded(steps: list[tuple[tuple[int, int], int, bytes, bool]]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(waiting, "MAX_WAITING_BYTES", 64)
        layers, keys = WaitingLayers(), set()
        for key, lod, payload, taken in steps:
            if taken:
                layers.take(key)
            else:
                layers.add(key, [(lod, memoryview(payload))])
            keys.add(key)
            assert layers.bytes <= 64
        left = sum(len(payload) for key in keys for _, payload in layers.take(key))
        assert layers.bytes == 0
        assert left <= 64
