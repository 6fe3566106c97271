import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_common.errors import ProtocolError
from cags_protocol.delivery.assembly import Assembler, ReceivedPackets
from cags_protocol.sessions.blobs import MAX_BLOBS_AT_ONCE, BlobAssembler, blob_chunks
from cags_protocol.wire import limits
from cags_protocol.wire.messages import Blob, Fragment, SeqRange


@given(st.lists(st.integers(0, 60), max_size=80))
def test_ranges_are_what_arrived(numbers):
    packets, seen = ReceivedPackets(), set()
    for number in numbers:
        assert packets.add(number) == (number not in seen)
        seen.add(number)
    covered = [n for r in packets.ranges for n in range(r.first, r.last + 1)]
    assert sorted(covered) == sorted(seen)
    assert all(
        later.first > earlier.last + 1 for later, earlier in zip(packets.ranges, packets.ranges[1:], strict=False)
    )


def test_only_the_newest_ranges_are_kept():
    packets = ReceivedPackets()
    for number in range(0, 200, 2):
        assert packets.add(number)
    assert len(packets.ranges) == limits.MAX_ACK_RANGES
    assert packets.ranges[0] == SeqRange(198, 198)
    assert not packets.add(1)
    oldest = packets.ranges[-1].first
    assert not packets.add(oldest - 2), "too old to tell"
    assert packets.add(oldest - 1), "it makes the oldest range longer, and takes no room"
    assert packets.ranges[-1] == SeqRange(oldest - 1, oldest)
    assert len(packets.ranges) == limits.MAX_ACK_RANGES


def pieces(data, size, ident=1):
    for offset in range(0, len(data), size):
        yield Fragment(offset + 1, ident, offset, len(data)), memoryview(data)[offset : offset + size]


@given(st.binary(min_size=2, max_size=300), st.integers(1, 50), st.randoms())
def test_fragments_in_any_order_make_the_message(data, size, rng):
    parts = list(pieces(data, min(size, len(data) - 1)))
    rng.shuffle(parts)
    assembler = Assembler()
    out = [bytes(made) for part in parts if (made := assembler.add(*part)) is not None]
    assert out == [data]
    assert len(assembler) == assembler.partial_bytes == 0


def test_a_whole_message_is_not_copied():
    chunk = memoryview(b"whole")
    assert Assembler().add(Fragment(1, 1), chunk) is chunk


def test_abandoned_messages_leave_nothing_and_stay_gone():
    assembler = Assembler()
    first, second, *_ = pieces(bytes(100), 30)
    assembler.add(*first)
    assembler.abandon(1)
    assert assembler.add(*second) is None
    assert len(assembler) == assembler.partial_bytes == 0


@pytest.mark.parametrize(
    "second",
    [Fragment(2, 1, 0, 100), Fragment(2, 1, 50, 90)],
    ids=["the same bytes", "another length"],
)
def test_contradictions_are_refused(second):
    assembler = Assembler()
    assembler.add(Fragment(1, 1, 0, 100), memoryview(bytes(30)))
    with pytest.raises(ProtocolError, match="contradicts"):
        assembler.add(second, memoryview(bytes(30)))


def test_overlaps_are_refused():
    assembler = Assembler()
    assembler.add(Fragment(1, 1, 0, 50), memoryview(bytes(30)))
    with pytest.raises(ProtocolError, match="overlap"):
        assembler.add(Fragment(2, 1, 20, 50), memoryview(bytes(30)))


def test_half_received_messages_are_bounded_in_number_and_bytes():
    assembler = Assembler()
    for ident in range(10 * limits.MAX_PARTIAL_MESSAGES):
        assembler.add(Fragment(ident, ident, 0, limits.MAX_MESSAGE_BYTES), memoryview(bytes(10)))
    assert len(assembler) <= limits.MAX_PARTIAL_MESSAGES
    half = memoryview(bytes(limits.MAX_MESSAGE_BYTES // 2))
    for ident in range(10_000, 10_010):
        assembler.add(Fragment(ident, ident, 0, limits.MAX_MESSAGE_BYTES), half)
    assert assembler.partial_bytes <= limits.MAX_PARTIAL_BYTES


def test_blobs_come_together_in_any_order_and_repeated():
    data = random.Random(1).randbytes(3 * limits.BLOB_CHUNK_BYTES + 5)
    chunks = list(blob_chunks("x", data))
    assembler = BlobAssembler()
    out = [assembler.add(*chunk) for chunk in (chunks[2], chunks[0], chunks[2], chunks[3], chunks[1])]
    assert out == [None] * 4 + [data]
    assert assembler.add(*next(blob_chunks("x", b"again"))) == b"again"


def test_chunks_that_overlap_and_yet_add_up_are_refused():
    assembler = BlobAssembler()
    assert assembler.add(Blob("x", 0, 10), memoryview(b"aaaaa")) is None
    with pytest.raises(ProtocolError, match="overlap"):
        assembler.add(Blob("x", 3, 10), memoryview(b"bbbbb"))


def test_a_blob_keeps_its_total():
    assembler = BlobAssembler()
    assembler.add(Blob("x", 0, 10), memoryview(b"aaaaa"))
    with pytest.raises(ProtocolError, match="earlier chunk"):
        assembler.add(Blob("x", 5, 11), memoryview(b"bbbbb"))


def test_too_many_or_overlapping_blobs_are_refused():
    assembler = BlobAssembler()
    for number in range(MAX_BLOBS_AT_ONCE):
        assembler.add(Blob(f"b{number}", 0, 100), memoryview(bytes(10)))
    with pytest.raises(ProtocolError, match="half sent at once"):
        assembler.add(Blob("one more", 0, 100), memoryview(bytes(10)))
    assembler = BlobAssembler()
    assembler.add(Blob("b", 0, 15), memoryview(bytes(10)))
    with pytest.raises(ProtocolError, match="overlap"):
        assembler.add(Blob("b", 5, 15), memoryview(bytes(10)))
