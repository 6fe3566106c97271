"""The web client's session sends, byte for byte, and says what Python's does, in every state and over bad networks."""

from __future__ import annotations

import dataclasses
import json
import random
import zlib
from pathlib import Path
from typing import Any

import pytest

from cags_common.geometry import Pose
from cags_common.tiles.inventory import InventoryEntry
from cags_protocol import ClientSession, Outgoing
from cags_protocol import events as ev
from cags_protocol.events import Closed
from cags_protocol.sessions.blobs import blob_chunks
from cags_protocol.wire import messages as m
from cags_protocol.wire.encoding import encode
from cags_protocol.wire.limits import PROTOCOL_VERSION
from support.node import run_tests
from support.wire_pair import INTRINSICS, Deliveries, Pair, reference, tile

NAMES = {
    ev.Welcomed: "welcomed", ev.BlobReceived: "blob", ev.TileReceived: "tile", ev.ReferenceReceived: "reference",
    ev.FrameEnded: "frame_end", ev.MarkReceived: "mark", ev.NoticeReceived: "notice", ev.Refused: "refused",
    Closed: "closed",
}  # fmt: skip


class Recording(ClientSession):
    """A client's session that writes down what it is told and what it answers."""

    def __init__(self) -> None:
        self.steps: list[dict[str, Any]] = []
        super().__init__(now_us=0)

    def _note(self, op: str, **what: Any) -> None:
        self.steps.append({"op": op, **what, "state": self.state.value})

    def hello(self, hello: m.Hello, *, now_us: int) -> None:
        super().hello(hello, now_us=now_us)
        self._note("hello", message=_plain(hello), now=now_us)

    def receive(self, data: Any, *, now_us: int) -> None:
        super().receive(data, now_us=now_us)
        self._note("receive", data=bytes(data).hex(), now=now_us)

    def send_poses(self, samples: Any, *, now_us: int, cadence_permille: int = 1000) -> None:
        poses = tuple(samples)
        super().send_poses(poses, now_us=now_us, cadence_permille=cadence_permille)
        self._note("poses", samples=[_plain(s) for s in poses], cadence=cadence_permille, now=now_us)

    def control(self, control: m.Control, *, now_us: int) -> None:
        super().control(control, now_us=now_us)
        self._note("control", message=_plain(control), now=now_us)

    def request_keyframe(self, reference_seq: int, *, now_us: int) -> None:
        super().request_keyframe(reference_seq, now_us=now_us)
        self._note("keyframe", seq=reference_seq, now=now_us)

    def report_evictions(self, tiles: Any) -> None:
        given = list(tiles)
        super().report_evictions(given)
        self._note("evictions", tiles=[_plain(t) for t in given])

    def data_to_send(self, now_us: int) -> list[bytes]:
        out = super().data_to_send(now_us)
        self._note("data", now=now_us, buffered=self.buffered_bytes, out=[data.hex() for data in out])
        return out

    def next_timer_us(self) -> int | None:
        due_us = super().next_timer_us()
        self._note("timer", due=due_us)
        return due_us

    def handle_timer(self, *, now_us: int) -> None:
        super().handle_timer(now_us=now_us)
        self._note("handle", now=now_us)

    def next_event(self) -> Any:
        event = super().next_event()
        self._note("event", event=None if event is None else _event(event), damaged=self.damaged_packets)
        return event

    def connection_lost(self, reason: str, *, now_us: int) -> None:
        super().connection_lost(reason, now_us=now_us)
        self._note("lost", reason=reason)

    def bye(self, reason: str = "", *, now_us: int) -> None:
        super().bye(reason, now_us=now_us)
        self._note("bye", reason=reason, now=now_us)


def _plain(value: Any) -> Any:
    return json.loads(json.dumps(dataclasses.asdict(value), default=lambda part: part.hex()))


def _event(event: Any) -> dict[str, Any]:
    told: dict[str, Any] = {"type": NAMES[type(event)]}
    if isinstance(event, ev.BlobReceived):
        told |= {"name": event.name, "crc": zlib.crc32(event.data)}
    elif isinstance(event, Closed):
        told |= {"code": event.code}
    message = getattr(event, "message", None)
    if message is not None:
        told |= {"fields": {k: v for k, v in _plain(message).items() if isinstance(v, int | str)}}
    payload = getattr(event, "payload", None)
    return told if payload is None else {**told, "payload": zlib.crc32(payload)}


def _network(rng: random.Random, loss: float, damage: float) -> Any:
    def fate(data: bytes) -> Deliveries:
        out = []
        for _ in range(1 + (rng.random() < 0.05)):
            if rng.random() < loss:
                continue
            wrong = bytearray(data)
            if rng.random() < damage:
                wrong[rng.randrange(len(wrong))] ^= 1 << rng.randrange(8)
            out.append((rng.randrange(1_000, 30_000), bytes(wrong)))
        return out

    return fate


def _transcript(seed: int) -> list[dict[str, Any]]:
    rng = random.Random(seed)
    bad = seed % 3
    pair = Pair(down=_network(rng, 0.03 * bad, 0.02 * bad))
    pair.client = Recording()
    pair.client.send_poses([m.PoseSample(1, Pose.identity())], now_us=0)  # not before the session is open
    welcome = m.Welcome("s", 30.0, 60, seed % 2 == 1, info=b'{"name":"room"}')
    pair.open(welcome, token="t" * (seed % 2), inventory=b"\1\0\0\0\2\0\3" * (seed % 3))
    for message, chunk in blob_chunks("codebooks", rng.randbytes(20_000)):
        pair.queue(Outgoing(message, chunk))
    for number in range(30):
        _busy(rng, pair, number)
    _ending(rng, pair)
    assert isinstance(pair.client, Recording)
    return pair.client.steps


def _busy(rng: random.Random, pair: Pair, number: int) -> None:
    pair.queue(*(tile(number, k, rng.randrange(1, 30_000)) for k in range(rng.randrange(3))))
    pair.queue(Outgoing(m.Mark(number + 1, rng.random() < 0.2)), reference(number, number + 1, rng.randrange(1, 5_000)))
    pair.queue(Outgoing(m.FrameEnd(number), b"\7" * rng.randrange(4)))
    if rng.random() < 0.2:
        pair.client.receive(encode(m.Notice("slow", "the link is slow")), now_us=pair.now_us)
    samples = [
        m.PoseSample(pair.now_us + k, Pose((0.1 * k, 1.0, -2.0), (0.5, 0.5, 0.5, 0.5)))
        for k in range(rng.choice([1, 2, 70]))
    ]
    pair.client.send_poses(samples, now_us=pair.now_us, cadence_permille=rng.choice([1000, 600]))
    if rng.random() < 0.3:
        action = rng.choice(["play", "pause", "seek", "rate"])
        control = m.Control(action, number, pair.now_us, rng.choice([1.0, 0.5]), rng.random() < 0.5, rng.random() < 0.5)
        pair.client.control(control, now_us=pair.now_us)
    if rng.random() < 0.2:
        pair.client.request_keyframe(number, now_us=pair.now_us)
    if rng.random() < 0.3:
        pair.client.report_evictions([InventoryEntry(number, k, k % 9) for k in range(rng.choice([1, 600]))])
    pair.client.buffered_bytes = rng.randrange(100_000)
    pair.run(rng.choice([3_000, 20_000, 200_000]))


def _ending(rng: random.Random, pair: Pair) -> None:
    now = pair.now_us
    match rng.randrange(6):
        case 0:
            pair.client.bye("viewer left", now_us=now)
        case 1:
            pair.client.connection_lost("reset", now_us=now)
        case 2:
            pair.client.receive(encode(m.Welcome("again", 30.0, 60)), now_us=now)
        case 3:
            pair.server.bye("the server stops", now_us=now)
        case 4:
            pair.down = lambda data: []  # nothing is heard any more
            pair.run(16_000_000)
        case _:
            for _ in range(20):
                pair.client.receive(rng.randbytes(50), now_us=now)
    pair.run(100_000)
    pair.client.receive(encode(m.Ping(1)), now_us=pair.now_us)


@pytest.mark.parametrize("first", [0, 10])
def test_transcripts_of_sessions_over_good_and_bad_networks(first: int, tmp_path: Path) -> None:
    run_tests("session", tmp_path, transcripts=[_transcript(seed) for seed in range(first, first + 10)])


def test_transcripts_of_handshakes(tmp_path: Path) -> None:
    transcripts = []
    hello = m.Hello(PROTOCOL_VERSION, INTRINSICS, Pose.identity())
    for data in (
        encode(m.Refusal("full", "", "no room")),
        encode(m.Ping(2**60)),
        encode(m.Bye("stopping")),
        encode(m.Mark(1)),
        b"\xc1\xc1",
        encode(m.Notice("a", "b")),
    ):
        for greeted in (False, True):
            session = Recording()
            if greeted:
                session.hello(hello, now_us=5)
            session.receive(data, now_us=10)
            session.data_to_send(11)
            session.next_timer_us()
            session.handle_timer(now_us=10_000_000)
            while session.next_event() is not None:
                pass
            session.data_to_send(10_000_001)
            transcripts.append(session.steps)
    run_tests("session", tmp_path, transcripts=transcripts)
