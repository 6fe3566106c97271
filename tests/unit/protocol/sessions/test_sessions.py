import pytest

from cags_common.errors import ProtocolError
from cags_common.geometry import Pose
from cags_common.tiles.inventory import InventoryEntry
from cags_protocol import ClientSession, Outgoing, ServerSession, ServerSessionSettings, SessionTimers, State
from cags_protocol import events as ev
from cags_protocol.delivery.flow import PACING_GAIN
from cags_protocol.sessions.blobs import blob_chunks
from cags_protocol.sessions.states import CLIENT_TABLE, SERVER_TABLE
from cags_protocol.wire import messages as m
from cags_protocol.wire.encoding import decode, encode
from cags_protocol.wire.limits import PACKET_BYTES, PROTOCOL_VERSION
from support.wire_pair import INTRINSICS, Pair, hello, reference, steady, tile


def test_a_handshake_opens_both():
    pair = Pair().open()
    assert pair.server_events(ev.Joined)[0].hello == hello()
    assert pair.client_events(ev.Welcomed)[0].welcome.info == b"{}"
    assert pair.server.state is pair.client.state is State.OPEN


def test_a_refused_client_knows_why():
    pair = Pair()
    pair.client.hello(hello(), now_us=0)
    pair.run(30_000)
    pair.server.refuse(m.RefusalCode.FULL, "", "16 clients at most", now_us=pair.now_us)
    pair.run(30_000)
    assert pair.client_events(ev.Refused)[0].refusal == m.Refusal("full", "", "16 clients at most")
    assert pair.client.closed
    assert pair.server.closed
    assert pair.client_events(ev.Closed)[0].code == "refused"


@pytest.mark.parametrize("code", m.RefusalCode)
def test_every_reason_reaches_the_client_as_it_is(code):
    pair = Pair()
    pair.client.hello(hello(), now_us=0)
    pair.run(30_000)
    pair.server.refuse(code, "field", "why", now_us=pair.now_us)
    pair.run(30_000)
    refusal = pair.client_events(ev.Refused)[0].refusal
    assert (refusal.code, refusal.field, refusal.message) == (code.value, "field", "why")
    assert type(pair.server_events(ev.Closed)[0].code) is str


def test_a_client_of_another_version_is_refused_by_name_of_both_versions():
    server = ServerSession(now_us=0)
    server.receive(encode(hello(version=7)), now_us=1)
    refusal, _ = decode(server.data_to_send(1)[0])
    assert refusal.code == refusal.field == "version"
    assert "7" in refusal.message
    assert f"speaks {PROTOCOL_VERSION}" in refusal.message
    assert server.closed


def test_poses_controls_and_key_frame_requests_arrive():
    pair = Pair().open()
    samples = tuple(m.PoseSample(i, Pose((float(i), 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))) for i in range(150))
    pair.client.send_poses(samples, now_us=pair.now_us)
    pair.client.control(m.Control("play", 0, 5), now_us=pair.now_us)
    pair.client.request_keyframe(3, now_us=pair.now_us)
    pair.run(30_000)
    assert sum((e.samples for e in pair.server_events(ev.PosesReceived)), ()) == samples
    assert pair.server_events(ev.ControlReceived)[0].control == m.Control("play", 0, 5)
    assert pair.server_events(ev.KeyframeRequested) == [ev.KeyframeRequested(3)]


def test_tiles_and_references_arrive_and_are_reported_delivered():
    pair = Pair().open()
    sent = [tile(0, i, 20_000, priority=1) for i in range(4)] + [reference(0, 1, 3000), Outgoing(m.FrameEnd(0), b"", 2)]
    pair.queue(*sent)
    pair.run(2_000_000)
    assert pair.tiles() == [(0, 0), (0, 1), (0, 2), (0, 3)]
    for event, outgoing in zip(pair.client_events(ev.TileReceived), sent, strict=False):
        assert bytes(event.payload) == outgoing.payload
    delivered = [e.outgoing for e in pair.server_events(ev.Delivered)]
    assert sorted(map(id, delivered)) == sorted(map(id, sent))
    assert len(pair.client_events(ev.FrameEnded)) == 1


def test_blobs_arrive_whole():
    pair = Pair().open()
    data = bytes(range(256)) * 3000
    for message, chunk in [*blob_chunks("codebooks", data), *blob_chunks("empty", b"")]:
        pair.queue(Outgoing(message, chunk))
    pair.run(5_000_000)
    assert [(e.name, e.data) for e in pair.client_events(ev.BlobReceived)] == [("codebooks", data), ("empty", b"")]


def test_no_packet_is_longer_than_8_kib():
    pair = Pair().open()
    pair.queue(tile(0, 0, 100_000))
    pair.run(2_000_000)
    assert max(map(len, pair.packets_down)) <= PACKET_BYTES


def test_little_is_in_flight_on_a_slow_link():
    """Two packets of 8 KiB, and two more for references, take 1.3 s of 200 kbit/s, and nothing overtakes them."""
    free_us = 0

    def thin(data):
        nonlocal free_us
        free_us = max(free_us, pair.now_us) + len(data) * 40
        return [(free_us - pair.now_us + 10_000, data)]

    pair = Pair().open()
    pair.down, pair.server.rate_hint_bps = thin, 200e3
    pair.queue(tile(0, 0, 30_000, priority=2))
    worst_us = 0
    for frame in range(60):
        pair.queue(reference(frame, frame + 1, 200), Outgoing(m.FrameEnd(frame), b"", 1))
        pair.run(33_333)
        worst_us = max(worst_us, free_us - pair.now_us)
    assert worst_us < 300_000
    ends = [event.message.frame for event in pair.client_events(ev.FrameEnded)]
    assert ends == list(range(len(ends)))
    assert len(ends) >= 50


def test_a_reference_overtakes_a_half_sent_tile():
    pair = Pair().open()
    pair.server.rate_hint_bps = 1e6
    pair.queue(tile(0, 0, 200_000))
    pair.run(15_000)
    pair.queue(reference(0, 1, 3000, priority=9))
    pair.run(40_000)
    assert len(pair.client_events(ev.ReferenceReceived)) == 1
    assert not pair.tiles()
    pair.run(20_000_000)
    assert pair.tiles() == [(0, 0)]


def test_a_reference_does_not_wait_for_credit():
    pair = Pair().open()
    pair.up = lambda data: []  # no acknowledgement ever arrives
    pair.queue(tile(0, 0, 200_000))
    pair.run(100_000)
    in_flight = pair.server.in_flight_bytes
    pair.queue(tile(0, 1, 1000, priority=0), reference(0, 1, 3000))
    pair.run(15_000)
    assert len(pair.client_events(ev.ReferenceReceived)) == 1
    assert pair.server.in_flight_bytes > in_flight


def test_tiles_after_a_pause_do_not_fill_the_link_at_a_stroke():
    pair = Pair(down=steady(50_000), up=steady(50_000)).open()
    pair.server.rate_hint_bps = 8e6
    pair.run(1_000_000)
    before = sum(map(len, pair.packets_down))
    pair.queue(tile(0, 0, 200_000))
    pair.run(10_000)
    burst = sum(map(len, pair.packets_down)) - before
    assert burst <= PACING_GAIN * 8e6 * 0.03 / 8 + PACKET_BYTES, "credit for a whole round trip is there"
    pair.queue(reference(0, 1, 3000))
    pair.run(50_000)
    assert len(pair.client_events(ev.ReferenceReceived)) == 1, "a reference leaves at once"
    pair.run(5_000_000)
    assert pair.tiles() == [(0, 0)]


def test_more_valuable_tiles_overtake():
    pair = Pair().open()
    pair.queue(tile(0, 0, 1000, priority=3), tile(0, 1, 1000, priority=1), tile(0, 2, 1000, priority=2))
    pair.run(1_000_000)
    assert pair.tiles() == [(0, 1), (0, 2), (0, 0)]


def test_the_credit_window_bounds_what_is_in_flight():
    pair = Pair(down=steady(50_000), up=steady(50_000)).open()
    pair.server.rate_hint_bps = 8e6
    pair.queue(tile(0, 0, 2_000_000))
    worst = 0
    for _ in range(200):
        pair.run(5_000)
        worst = max(worst, pair.server.in_flight_bytes)
    assert worst <= 8e6 * (0.08 + 0.1 + 0.01) / 8 + PACKET_BYTES
    assert worst >= 8e6 * 0.1 / 8


def test_stale_tiles_are_dropped_and_accounted():
    pair = Pair().open()
    pair.server.rate_hint_bps = 1e5
    late = tile(0, 1, 50_000, deadline_us=pair.now_us + 100_000)
    big = tile(0, 0, 300_000, deadline_us=pair.now_us + 100_000)
    pair.queue(big, late)
    pair.run(5_000_000)
    dropped = {id(e.outgoing): e for e in pair.server_events(ev.Dropped)}
    assert dropped[id(late)].reason == dropped[id(big)].reason == "stale"
    assert dropped[id(late)].sent_bytes == 0
    assert dropped[id(big)].sent_bytes > 0
    assert not pair.tiles()
    assert not pair.client._assembler.partial_bytes  # the client was told to forget the half that came


def test_a_newer_message_of_the_same_key_replaces_one_that_waits():
    pair = Pair().open()
    old, new = tile(0, 0, 100, key="a"), tile(1, 0, 100, key="a")
    pair.queue(old, new)
    pair.run(1_000_000)
    assert pair.tiles() == [(1, 0)]
    assert [(e.outgoing, e.reason) for e in pair.server_events(ev.Dropped)] == [(old, "replaced")]


def test_what_a_seek_makes_useless_is_cancelled():
    pair = Pair().open()
    pair.queue(tile(0, 0, 100), tile(1, 0, 100))
    pair.server.cancel(lambda outgoing: outgoing.message.frame == 0, now_us=pair.now_us)
    pair.run(1_000_000)
    assert pair.tiles() == [(1, 0)]


def test_a_full_queue_drops_the_least_valuable():
    pair = Pair(server=ServerSessionSettings(max_queue_bytes=10_000)).open()
    pair.queue(tile(0, 0, 4000, priority=5), tile(0, 1, 4000, priority=1), tile(0, 2, 4000, priority=3))
    pair.run(1_000_000)
    assert pair.tiles() == [(0, 1), (0, 2)]
    assert [e.reason for e in pair.server_events(ev.Dropped)] == ["overflow"]


def test_acknowledgements_measure_rate_and_round_trip():
    pair = Pair(down=steady(20_000), up=steady(15_000)).open()
    pair.queue(tile(0, 0, 500_000))
    pair.run(3_000_000)
    samples = [e.sample for e in pair.server_events(ev.Acknowledged)]
    assert all(35_000 <= s.rtt_us <= 36_000 for s in samples)
    assert sum(s.newly_delivered_bytes for s in samples) == sum(
        len(p) for p in pair.packets_down if isinstance(decode(p)[0], m.Fragment)
    )
    assert samples[-1].in_flight_bytes == 0


def test_an_idle_server_marks_its_samples_application_limited():
    pair = Pair().open()
    for frame in range(5):
        pair.queue(tile(frame, 0, 500))
        pair.run(100_000)
    assert all(e.sample.app_limited for e in pair.server_events(ev.Acknowledged)[1:])


def test_evictions_reach_the_server():
    pair = Pair().open()
    gone = tuple(InventoryEntry(frame, 1, 0) for frame in range(1200))
    pair.client.report_evictions(gone)
    pair.client.buffered_bytes = 777
    pair.queue(tile(0, 0, 10))
    pair.run(200_000)
    assert sum((e.tiles for e in pair.server_events(ev.Evicted)), ()) == gone
    assert pair.server_events(ev.Acknowledged)[0].sample.undecoded_bytes == 777


def test_what_was_discarded_on_arrival_is_told_of_after_the_arrival():
    """The other way round a server would believe in what is gone."""
    pair = Pair().open()
    pair.queue(tile(0, 0, 10))
    while not pair.tiles():
        pair.run(1_000)
    pair.client.report_evictions((InventoryEntry(0, 0, 0),))
    pair.run(200_000)
    kinds = [type(event) for _, event in pair.server_log]
    assert kinds.index(ev.Delivered) < kinds.index(ev.Evicted)


def test_evictions_before_the_welcome_wait_for_it_and_ask_for_no_timer():
    """The time of an acknowledgement that could not be sent was in the past, and the client's loop spun until then."""
    pair = Pair()
    pair.client.hello(hello(), now_us=0)
    gone = (InventoryEntry(3, 1, 0),)
    pair.client.report_evictions(gone)
    pair.run(30_000)
    assert pair.client.next_timer_us() == SessionTimers().handshake_us
    pair.server.accept(m.Welcome("s", 30.0, 100), now_us=pair.now_us)
    pair.run(30_000)
    assert sum((e.tiles for e in pair.server_events(ev.Evicted)), ()) == gone


def test_an_idle_session_is_kept_alive():
    pair = Pair().open().run(120_000_000)
    assert not pair.server.closed
    assert not pair.client.closed


@pytest.mark.parametrize("dead", ["down", "up"])
def test_a_silent_peer_is_given_up(dead):
    pair = Pair().open()
    setattr(pair, dead, lambda data: [])
    pair.run(40_000_000)
    assert pair.server.closed
    assert pair.client.closed


def test_a_client_that_never_says_hello_is_dropped():
    timers = SessionTimers(handshake_us=1_000_000)
    server = ServerSession(ServerSessionSettings(timers=timers), now_us=0)
    assert server.next_timer_us() == 1_000_000
    server.handle_timer(now_us=1_000_000)
    assert server.closed
    assert decode(server.data_to_send(1_000_000)[0])[0].code == "timeout"


def test_a_bye_ends_both_and_drops_what_waits():
    pair = Pair().open()
    waiting = tile(0, 0, 1_000_000)
    pair.queue(waiting)
    pair.client.bye("enough", now_us=pair.now_us)
    pair.run(100_000)
    assert pair.server_events(ev.Closed) == [ev.Closed("bye", "enough")]
    assert [(e.outgoing, e.reason) for e in pair.server_events(ev.Dropped)] == [(waiting, "closed")]
    assert pair.client_events(ev.Closed) == [ev.Closed("bye", "enough")]


def test_what_is_queued_after_the_end_is_dropped():
    pair = Pair().open()
    pair.server.bye(now_us=pair.now_us)
    pair.queue(tile(0, 0, 10))
    pair.run(0)
    assert pair.server_events(ev.Dropped)[0].reason == "closed"


def test_a_lost_connection_is_an_event():
    pair = Pair().open()
    pair.client.connection_lost("reset by peer", now_us=pair.now_us)
    pair.run(0)
    assert pair.client_events(ev.Closed) == [ev.Closed("lost", "reset by peer")]
    assert pair.client.next_timer_us() is None


@pytest.mark.parametrize(
    "message",
    [m.Welcome("s", 1.0, 1), hello(), m.Fragment(1, 1, 0, 1)],
    ids=lambda v: v.TAG,
)
def test_a_message_out_of_place_ends_the_session_with_a_refusal(message):
    pair = Pair().open()
    pair.server.receive(encode(message, b"x" if message.PAYLOAD == m.OPAQUE else b""), now_us=pair.now_us)
    assert pair.server.closed
    assert decode(pair.server.data_to_send(pair.now_us)[-1])[0].code == "unexpected"


def test_an_acknowledgement_of_what_was_never_sent_is_refused():
    pair = Pair().open()
    pair.server.receive(encode(m.Ack((m.SeqRange(1, 10**6),), 0)), now_us=pair.now_us)
    assert pair.server.closed


def test_after_the_end_nothing_is_heard():
    pair = Pair().open()
    pair.server.bye(now_us=pair.now_us)
    pair.server.receive(b"garbage", now_us=pair.now_us)
    assert pair.server.closed


def test_calls_out_of_turn_are_errors_of_the_caller():
    with pytest.raises(ProtocolError, match="not in state greeting"):
        ServerSession(now_us=0).accept(m.Welcome("s", 1.0, 1), now_us=0)
    client = ClientSession(now_us=0)
    client.hello(hello(), now_us=0)
    with pytest.raises(ProtocolError, match="once"):
        client.hello(hello(), now_us=0)


def test_tables_send_no_one_back_and_know_every_message():
    for table in (SERVER_TABLE, CLIENT_TABLE):
        order = list(State)
        assert all(order.index(after) >= order.index(before) for (before, _), after in table.items())
    assert {kind for _, kind in SERVER_TABLE} == set(m.CLIENT_MESSAGES)
    assert {kind for _, kind in CLIENT_TABLE} == set(m.SERVER_MESSAGES) - set(m.SERVER_DATA)


def test_a_reference_camera_comes_through():
    pair = Pair().open()
    pair.queue(reference(4, 2, 10))
    pair.run(100_000)
    assert pair.client_events(ev.ReferenceReceived)[0].message.intrinsics == INTRINSICS
