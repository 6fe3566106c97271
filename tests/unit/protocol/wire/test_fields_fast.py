"""Hundreds of records in one message: read at once, and just as strictly."""

import time
from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_common.errors import ProtocolError
from cags_common.tiles.inventory import InventoryEntry
from cags_protocol.wire.encoding import decode, encode
from cags_protocol.wire.fields import Integer, ListOf, Record
from cags_protocol.wire.messages import Ack, SeqRange


@dataclass(frozen=True)
class Pair:
    first: int
    second: int

    def __post_init__(self):
        if self.first > self.second:
            raise ValueError("falls")


PAIRS = ListOf(Record(Pair, ("first", "second"), (Integer(10), Integer(20, 1))), 5)
odd = st.one_of(st.integers(-2, 25), st.booleans(), st.floats(), st.text(max_size=2), st.none(), st.lists(st.none()))
raws = st.lists(
    st.one_of(st.lists(odd, max_size=4), odd, st.lists(st.integers(0, 22), min_size=2, max_size=3)), max_size=6
)


@given(raws)
def test_the_fast_way_says_the_same_as_the_slow_one(raw):
    try:
        slow = tuple(PAIRS.kind.unpack(item, "pairs") for item in raw) if len(raw) <= 5 else None
    except ProtocolError:
        slow = None
    if slow is None:
        with pytest.raises(ProtocolError):
            PAIRS.unpack(raw, "pairs")
    else:
        assert PAIRS.unpack(raw, "pairs") == slow


def test_an_acknowledgement_full_of_evictions_costs_little_more_than_its_records():
    """Interleaved, as machines are shared: 512 records cost less than 100 plain acknowledgements."""
    full = encode(Ack((SeqRange(0, 0),), 1, 0, 0, tuple(InventoryEntry(2**30 + i, i, 1) for i in range(512))))
    plain = encode(Ack((SeqRange(0, 0),), 1, 0, 0))

    def cost(data, times):
        begun = time.perf_counter()
        for _ in range(times):
            decode(data)
        return time.perf_counter() - begun

    ratios = [cost(full, 1) / cost(plain, 100) for _ in range(40)]
    assert min(ratios) < 1.0
