from cags_protocol import ServerSession
from cags_protocol import events as ev
from cags_protocol.sessions.tracing import FIELDS, EventTrace
from support.wire_pair import Pair, reference, tile


def traced():
    records = []
    pair = Pair()
    pair.server = ServerSession(now_us=0, trace=EventTrace(records.append, "s1"))
    return pair.open(), records


def test_a_trace_describes_itself_and_accounts_for_every_byte():
    pair, records = traced()
    pair.server.rate_hint_bps = 1e6
    pair.queue(tile(3, 0, 50_000, deadline_us=pair.now_us + 200_000), tile(3, 1, 5000), reference(3, 1, 900))
    pair.run(3_000_000)
    pair.server.bye(now_us=pair.now_us)
    header, *events = records
    assert header["trace"] == "cags-session"
    assert header["fields"] == FIELDS
    assert {key for record in events for key in record} <= set(FIELDS)
    kinds = [record["event"] for record in events]
    assert kinds.count("queued") == kinds.count("delivered") + kinds.count("dropped") == 3
    assert kinds[-1] == "closed"
    sent = sum(record["bytes"] for record in events if record["event"] == "sent")
    assert sent == sum(record["bytes"] for record in events if record["event"] == "acked")
    assert all(r["in_flight_bytes"] <= r["window_bytes"] + 16384 for r in events if r["event"] == "sent")
    assert [r["t_us"] for r in events] == sorted(r["t_us"] for r in events)


def test_tracing_changes_nothing():
    plain, (with_trace, _) = Pair().open(), traced()
    for pair in (plain, with_trace):
        pair.queue(*(tile(0, i, 9000) for i in range(20)))
        pair.run(1_000_000)
    assert plain.packets_down == with_trace.packets_down
    assert len(plain.server_events(ev.Delivered)) == len(with_trace.server_events(ev.Delivered)) == 20
