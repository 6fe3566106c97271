"""Wrong messages by the thousand: each is ignored, refused or ends the session cleanly; nothing raises."""

import random

import pytest

from cags_common.errors import ProtocolError
from cags_protocol import ClientSession, ServerSession
from cags_protocol import events as ev
from cags_protocol.wire import messages as m
from cags_protocol.wire.encoding import decode, encode
from support.wire_fuzz import fuzzed
from support.wire_pair import hello, tile


def open_server():
    session = ServerSession(now_us=0)
    session.receive(encode(hello()), now_us=0)
    session.accept(m.Welcome("s", 30.0, 10), now_us=0)
    session.queue(tile(0, 0, 30_000), now_us=0)
    session.data_to_send(0)
    return session


def open_client():
    session = ClientSession(now_us=0)
    session.hello(hello(), now_us=0)
    session.receive(encode(m.Welcome("s", 30.0, 10)), now_us=0)
    session.data_to_send(0)
    return session


def check_end(session, said):
    events = []
    while (event := session.next_event()) is not None:
        events.append(event)
    assert session.closed == any(isinstance(event, ev.Closed) for event in events)
    if session.closed:
        assert isinstance(events[-1], ev.Closed | ev.Dropped)
        assert all(decodes(data) for data in said)


def decodes(data):
    try:
        decode(data)
    except ProtocolError:
        return False
    return True


def fuzz(count, seed):
    rng = random.Random(seed)
    sessions = [
        (open_server, open_server()),
        (open_client, open_client()),
        (lambda: ServerSession(now_us=0), ServerSession(now_us=0)),
    ]
    closed = 0
    for number in range(count):
        index = number % len(sessions)
        make, session = sessions[index]
        session.receive(fuzzed(rng), now_us=number)
        said = session.data_to_send(number)
        if session.closed or rng.random() < 0.02:
            closed += session.closed
            check_end(session, said)
            sessions[index] = make, make()
    return closed


def test_five_thousand_wrong_messages():
    assert fuzz(5000, seed=1) > 1000


@pytest.mark.nightly
@pytest.mark.timeout(3600)
def test_a_million_wrong_messages():
    assert fuzz(1_000_000, seed=2) > 200_000


def test_a_fuzzer_that_changes_nothing_would_be_noticed():
    rng = random.Random(0)
    good = sum(decodes(fuzzed(rng)) for _ in range(2000))
    assert 20 < good < 1000
