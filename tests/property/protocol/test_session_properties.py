"""Two sessions meet over a network that delays, reorders, duplicates, loses and damages as hypothesis likes."""

import random

from hypothesis import given, settings
from hypothesis import strategies as st

from cags_common.errors import ProtocolError
from cags_protocol import Outgoing, ServerSessionSettings
from cags_protocol import events as ev
from cags_protocol.delivery.flow import LEAST_PACKET_BYTES, PACKET_US
from cags_protocol.wire import limits
from cags_protocol.wire import messages as m
from cags_protocol.wire.encoding import decode, encode
from support.wire_pair import Pair, reference, tile

HEADERS_BYTES = 400
"""Of a reference and of the packet that it is in, at most."""

SIZES = st.lists(st.tuples(st.integers(0, 40_000), st.integers(0, 5), st.integers(0, 60_000)), min_size=1, max_size=12)


@given(SIZES, st.integers(0, 2**32))
@settings(max_examples=40)
def test_over_a_reliable_network_everything_arrives_whole_and_exactly_once(plan, seed):
    rng = random.Random(seed)
    delay_us = rng.randrange(1, 80_000)
    pair = Pair(lambda d: [(delay_us, d)], lambda d: [(delay_us, d)]).open()
    sent = []
    for number, (size, priority, wait_us) in enumerate(plan):
        outgoing = reference(0, number, size) if priority == 5 else tile(0, number, size, priority=priority)
        pair.queue(outgoing)
        sent.append(outgoing)
        pair.run(wait_us)
    pair.run(30_000_000)
    got = {bytes(encode(e.message, e.payload)) for _, e in pair.client_log if hasattr(e, "payload")}
    assert got == {encode(o.message, o.payload) for o in sent}
    assert sorted(map(id, sent)) == sorted(id(e.outgoing) for e in pair.server_events(ev.Delivered))
    assert not pair.server_events(ev.Dropped)
    assert pair.server.in_flight_bytes == pair.server.queued_bytes == 0


def hostile(rng, damage, lose, double, worst_us):
    """Every message may come late, twice, damaged or not at all."""

    def fate(data):
        out = []
        for _ in range(2 if rng.random() < double else 1):
            if rng.random() < lose:
                continue
            copy = bytearray(data)
            if rng.random() < damage:
                copy[rng.randrange(len(copy))] ^= 1 << rng.randrange(8)
            out.append((rng.randrange(1, worst_us), bytes(copy)))
        return out

    return fate


@given(
    SIZES,
    st.integers(0, 2**32),
    st.floats(0, 0.05),
    st.floats(0, 0.2),
    st.floats(0, 0.3),
    st.integers(2, 200_000),
)
@settings(max_examples=40)
def test_over_a_hostile_network_every_message_is_settled_once_and_nothing_false_arrives(
    plan, seed, damage, lose, double, worst_us
):
    rng = random.Random(seed)
    pair = Pair(server=ServerSessionSettings(max_queue_bytes=200_000)).open()
    pair.down = hostile(rng, damage, lose, double, worst_us)
    pair.up = hostile(rng, 0.0, lose, double, worst_us)
    sent = []
    for number, (size, priority, wait_us) in enumerate(plan * 3):
        deadline = pair.now_us + rng.randrange(1, 500_000) if priority < 2 else None
        outgoing = tile(number, priority, size, priority=priority, deadline_us=deadline, key=number % 7)
        sent.append(outgoing)
        pair.queue(outgoing)
        pair.run(wait_us)
        assert pair.server.queued_bytes <= 200_000
        assert pair.client._assembler.partial_bytes <= 32 * 2**20
    pair.run(5_000_000)
    pair.server.bye(now_us=pair.now_us)
    pair.run(0)
    originals = {(o.message.frame, o.message.tile): bytes(o.payload) for o in sent}
    for event in pair.client_events(ev.TileReceived):
        assert originals[event.message.frame, event.message.tile] == bytes(event.payload)
    settled = [id(e.outgoing) for e in (*pair.server_events(ev.Delivered), *pair.server_events(ev.Dropped))]
    assert sorted(settled) == sorted(map(id, sent))
    arrived = {(e.message.frame, e.message.tile) for e in pair.client_events(ev.TileReceived)}
    for event in pair.server_events(ev.Delivered):
        assert (event.outgoing.message.frame, event.outgoing.message.tile) in arrived or pair.client.closed
    assert pair.server.in_flight_bytes == pair.server.queued_bytes == 0


@given(st.binary(max_size=300))
@settings(max_examples=300)
def test_any_bytes_are_a_message_or_a_protocol_error(data):
    try:
        message, payload = decode(data)
    except ProtocolError as error:
        assert "\n" not in str(error)
    else:
        again, rest = decode(encode(message, payload if message.PAYLOAD == m.OPAQUE else b""))
        assert (again, bytes(rest)) == (message, bytes(payload))


@given(st.lists(st.binary(max_size=80), max_size=10), st.booleans())
def test_any_bytes_leave_a_session_open_or_cleanly_closed(messages, after_handshake):
    pair = Pair().open() if after_handshake else Pair()
    for data in messages:
        pair.server.receive(data, now_us=pair.now_us)
        pair.client.receive(data, now_us=pair.now_us)
    pair.run(1000)
    for session, log in ((pair.server, pair.server_log), (pair.client, pair.client_log)):
        assert session.closed == any(isinstance(e, ev.Closed) for _, e in log)


@given(st.integers(0, 2**32))
@settings(max_examples=40)
def test_references_never_wait_behind_tiles(seed):
    """One that fits into its reserve is there at once; of a larger one the rest goes ahead of all tiles."""
    rng = random.Random(seed)
    pair = Pair().open()
    pair.server.rate_hint_bps = rng.choice([1e5, 1e6, 1e7])
    pair.queue(*(tile(0, i, rng.randrange(1, 50_000), priority=rng.randrange(4)) for i in range(10)))
    pair.run(rng.randrange(300_000))
    size, before = rng.randrange(1, 7000), len(pair.packets_down)
    pair.queue(reference(0, 1, size, priority=rng.randrange(10)))
    packet_bytes = min(max(pair.server.rate_hint_bps * PACKET_US / 8e6, LEAST_PACKET_BYTES), limits.PACKET_BYTES)
    pair.run(11_000)
    came = pair.client_events(ev.ReferenceReceived)
    if size + HEADERS_BYTES <= packet_bytes:
        assert len(came) == 1
    pair.run(300_000)
    assert len(pair.client_events(ev.ReferenceReceived)) == 1
    sent = [message for packet in pair.packets_down[before:] if isinstance(message := decode(packet)[0], m.Fragment)]
    of_reference = [i for i, fragment in enumerate(sent) if fragment.ident == max(each.ident for each in sent)]
    assert of_reference == list(range(len(of_reference)))


def test_order_of_queueing_is_kept_within_a_priority():
    pair = Pair().open()
    pair.queue(*(tile(0, i, 9000) for i in range(9)), Outgoing(m.FrameEnd(0)))
    pair.run(10_000_000)
    assert pair.tiles() == [(0, i) for i in range(9)]
    assert isinstance(pair.client_log[-1][1], ev.FrameEnded)
