import tracemalloc
from dataclasses import replace

import pytest

from cags_common.errors import ProtocolError
from cags_protocol.delivery.send_queue import CHUNK_BYTES, Outgoing, SendQueue
from cags_protocol.wire.encoding import decode
from cags_protocol.wire.limits import MAX_PARTIAL_MESSAGES, PACKET_BYTES
from cags_protocol.wire.messages import Blob, FrameEnd, Mark, TileLayers
from support.wire_pair import reference, tile


class Queue:
    """A queue, what it dropped, and what it sent."""

    def __init__(self, max_bytes=10**9, max_messages=10**6):
        self.dropped = []
        self.queue = SendQueue(max_bytes, max_messages, lambda entry, reason: self.dropped.append((entry, reason)))
        self.seq = 0

    def send(self):
        """Send one packet; the message it is of, and the fragment."""
        entry = self.queue.peek()
        self.seq += 1
        fragment, chunk = decode(self.queue.take_fragment(entry, self.seq))
        return entry.outgoing, fragment, bytes(chunk)

    def send_all(self):
        out = []
        while self.queue.peek() is not None:
            out.append(self.send())
        return out


def test_parts_of_blobs_are_dropped_last():
    """Without them a client could do nothing for the whole session."""
    q = Queue(max_bytes=2500)
    for offset in (0, 600, 1200):
        q.queue.put(Outgoing(Blob("codebooks", offset, 1800), bytes(600), priority=9))
        q.queue.put(tile(offset, 0, 600))
    assert [type(entry.outgoing.message) for entry, _ in q.dropped] == [TileLayers] * 3
    q.queue.put(Outgoing(Blob("weights", 0, 1200), bytes(1200), priority=9))
    assert isinstance(q.dropped[-1][0].outgoing.message, Blob)
    assert q.queue.queued_bytes <= 2500


def test_fragments_are_the_encoded_message_in_order():
    q = Queue()
    outgoing = tile(0, 0, 3 * CHUNK_BYTES)
    q.queue.put(outgoing)
    sent = q.send_all()
    data = b"".join(chunk for _, _, chunk in sent)
    message, payload = decode(data)
    assert message == outgoing.message
    assert bytes(payload) == outgoing.payload
    assert [f.offset for _, f, _ in sent] == [i * CHUNK_BYTES for i in range(4)]
    assert {f.total for _, f, _ in sent} == {len(data)}
    assert q.queue.queued_bytes == len(q.queue) == 0


def test_a_message_of_one_fragment_leaves_its_length_out():
    q = Queue()
    q.queue.put(tile(0, 0, 10))
    assert q.send()[1].total == 0


@pytest.mark.parametrize("size", range(CHUNK_BYTES - 120, CHUNK_BYTES + 1, 7))
def test_packets_around_the_border_fit(size):
    q = Queue()
    q.queue.put(tile(0, 0, size))
    while (entry := q.queue.peek()) is not None:
        q.seq += 1
        assert len(q.queue.take_fragment(entry, q.seq)) <= PACKET_BYTES


@pytest.mark.parametrize("packet_bytes", [1448, 3000, PACKET_BYTES])
def test_fragments_fit_the_packets_that_are_asked_for(packet_bytes):
    q = Queue()
    outgoing = tile(0, 0, 3 * CHUNK_BYTES)
    q.queue.put(outgoing)
    chunks = []
    while (entry := q.queue.peek()) is not None:
        q.seq += 1
        packet = q.queue.take_fragment(entry, q.seq, packet_bytes)
        assert len(packet) <= packet_bytes
        chunks.append(bytes(decode(packet)[1]))
    assert bytes(decode(b"".join(chunks))[1]) == outgoing.payload


def test_order_is_references_then_priority_then_first_come():
    q = Queue()
    order = [
        tile(0, 0, 10, priority=1),
        tile(0, 1, 10),
        reference(0, 1, 10, priority=7),
        tile(0, 2, 10),
        tile(0, 3, 10, priority=1),
    ]
    for outgoing in order:
        q.queue.put(outgoing)
    assert [order.index(outgoing) for outgoing, _, _ in q.send_all()] == [2, 1, 3, 0, 4]


def test_marks_go_before_what_is_urgent_and_that_before_references():
    q = Queue()
    urgent = replace(tile(0, 3, 10, priority=5), urgent=True)
    order = [tile(0, 0, 10), reference(0, 1, 10), Outgoing(Mark(1)), urgent, reference(1, 2, 10), Outgoing(Mark(2))]
    for outgoing in order:
        q.queue.put(outgoing)
    assert [order.index(outgoing) for outgoing, _, _ in q.send_all()] == [2, 5, 3, 1, 4, 0]


def test_no_tile_is_sent_to_its_end_between_a_mark_and_its_sending():
    q = Queue()
    for number in range(MAX_PARTIAL_MESSAGES // 2):
        q.queue.put(tile(0, number, 2 * CHUNK_BYTES - 1000, priority=MAX_PARTIAL_MESSAGES - number))
        q.send()
    q.queue.put(Outgoing(Mark(1)))
    assert q.send()[0].message == Mark(1), "however much is half sent"


def test_among_equals_the_half_sent_goes_on():
    q = Queue()
    first, better = tile(0, 0, 5 * CHUNK_BYTES, priority=2), tile(0, 1, 10, priority=1)
    q.queue.put(first)
    q.send()
    q.queue.put(tile(0, 2, 10, priority=2))
    q.queue.put(better)
    names = [outgoing.message.tile for outgoing, _, _ in q.send_all()]
    assert names == [1] + [0] * 5 + [2]


def test_no_more_messages_are_half_sent_than_a_client_may_keep():
    q = Queue()
    for number in range(MAX_PARTIAL_MESSAGES):
        q.queue.put(tile(0, number, 3 * CHUNK_BYTES, priority=MAX_PARTIAL_MESSAGES - number))
        q.send()
    assert sum(entry.started for entry in q.queue) <= MAX_PARTIAL_MESSAGES // 2


def test_what_must_not_travel_is_refused_when_it_is_queued():
    q = Queue()
    with pytest.raises(ProtocolError):
        q.queue.put(Outgoing(FrameEnd(-1)))
    assert len(q.queue) == q.queue.queued_bytes == 0


def test_the_number_of_messages_is_bounded():
    q = Queue(max_messages=3)
    for number in range(5):
        q.queue.put(tile(0, number, 10, priority=number % 2))
    assert len(q.queue) == 3
    assert {reason for _, reason in q.dropped} == {"overflow"}
    assert [entry.outgoing.message.tile for entry, _ in q.dropped] == [3, 1]


def test_what_is_half_sent_is_dropped_last_when_the_queue_is_full():
    q = Queue(max_bytes=3 * CHUNK_BYTES)
    q.queue.put(tile(0, 0, 2 * CHUNK_BYTES, priority=9))
    q.send()
    q.queue.put(tile(0, 1, 2 * CHUNK_BYTES, priority=0))
    assert [entry.outgoing.message.tile for entry, _ in q.dropped] == [1]


def test_what_is_begun_can_be_spared_from_cancelling():
    q = Queue()
    for number in range(2):
        q.queue.put(tile(0, number, 2 * CHUNK_BYTES))
    q.send()
    q.queue.cancel(lambda outgoing: True, started=False)
    assert [entry.outgoing.message.tile for entry, _ in q.dropped] == [1]
    q.queue.cancel(lambda outgoing: True)
    assert [entry.outgoing.message.tile for entry, _ in q.dropped] == [1, 0]


def test_deadlines_come_in_order_and_forget_what_is_gone():
    q = Queue()
    for number, deadline in enumerate((300, 100, 200)):
        q.queue.put(tile(0, number, 10, deadline_us=deadline))
    assert q.queue.next_deadline_us() == 100
    q.queue.cancel(lambda outgoing: outgoing.message.tile == 1)
    assert q.queue.next_deadline_us() == 200
    q.queue.expire(250)
    assert [(entry.outgoing.message.tile, reason) for entry, reason in q.dropped] == [(1, "cancelled"), (2, "stale")]
    q.send_all()
    assert q.queue.next_deadline_us() is None


def test_a_half_sent_message_is_not_replaced_by_its_key():
    q = Queue()
    q.queue.put(tile(0, 0, 2 * CHUNK_BYTES, key="a"))
    q.send()
    q.queue.put(tile(1, 0, 10, key="a"))
    q.queue.put(tile(2, 0, 10, key="a"))
    assert [(entry.outgoing.message.frame, reason) for entry, reason in q.dropped] == [(1, "replaced")]
    assert {outgoing.message.frame for outgoing, _, _ in q.send_all()} == {0, 2}


def test_what_was_dropped_leaves_no_memory_behind_a_message_that_waits():
    """A congested link: a base layer always waits, and detail of lower priority is chosen and dropped for ever."""
    q = Queue()
    q.queue.put(tile(0, 0, 10))
    tracemalloc.start()
    try:
        for frame in range(20_000):
            q.queue.put(Outgoing(FrameEnd(frame), priority=3, deadline_us=frame))
            q.queue.expire(frame)
            q.dropped.clear()
        held_bytes, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert held_bytes < 100_000
    assert q.queue.peek().outgoing.priority == 0
