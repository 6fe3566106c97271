"""A compressed soak test: hours of a session in virtual time, with occasional faults of every kind.

A viewer joins, watches, seeks, pauses, changes speed, loses its connection and returns with its inventory, over a
looping mobile trace whose messages are occasionally damaged, duplicated or swapped. Nothing may raise or grow without
bound, all sessions must end cleanly, and nothing in the inventory of a returning viewer may be sent again.
"""

from __future__ import annotations

import random
from collections import Counter
from dataclasses import dataclass, field

from cags_bench.network.load import INTRINSICS, ZEROS
from cags_common.geometry import Pose
from cags_common.tiles.inventory import InventoryEntry
from cags_protocol import PROTOCOL_VERSION, ClientSession, Outgoing, ServerSession
from cags_protocol import events as ev
from cags_protocol.wire.inventory import pack_inventory, unpack_inventory
from cags_protocol.wire.messages import Control, FrameEnd, Hello, PoseSample, ReferenceFrame, TileLayers, Welcome
from cags_server.link import MeasuredLink
from cags_shaper.link import Link, LinkSettings, tcp_wire_bytes
from cags_shaper.trace import Trace

FPS = 5
FRAMES = 3000
TILES = 3
LODS = 3
STORE_TILES = 2000
FRAME_US = round(1e6 / FPS)
POSE_US = 100_000


@dataclass(frozen=True)
class Faults:
    """Frequencies of faults, per message or per second."""

    damage: float = 2e-5
    double: float = 1e-3
    swap: float = 1e-3
    disconnects_per_s: float = 1 / 120
    controls_per_s: float = 1 / 15


@dataclass
class SoakResult:
    """Result of a soak test. ``max_`` fields are maxima over time."""

    endings: Counter[str] = field(default_factory=Counter)
    events: Counter[str] = field(default_factory=Counter)
    drops: Counter[str] = field(default_factory=Counter)
    connections: int = 0
    resumed_tiles: int = 0
    sent_again: int = 0
    """Layers sent although they were in the viewer's inventory; must be 0."""
    unsettled: int = 0
    """Messages that were neither delivered nor dropped; must be 0."""
    messages: int = 0
    max_queued_bytes: int = 0
    max_in_flight_bytes: int = 0
    max_partial_bytes: int = 0


class _Wire:
    """One direction: a link whose messages belong to a connection, and its faults."""

    def __init__(self, link: Link[tuple[int, bytes]], rng: random.Random, faults: Faults) -> None:
        self.link, self._rng, self._faults = link, rng, faults
        self._held: tuple[int, bytes] | None = None  # held back until the next one overtakes it

    def push(self, connection: int, data: bytes, now_us: int) -> None:
        """Send a message."""
        self.link.push(now_us, (connection, data), tcp_wire_bytes(len(data)))

    def pop(self, connection: int, now_us: int) -> list[bytes]:
        """Messages that arrive on a connection now, with faults; those of other connections are lost."""
        out: list[bytes] = []
        for item in self.link.pop_due(now_us):
            batch = [item]
            if self._held is not None:
                batch, self._held = [item, self._held], None
            elif self._rng.random() < self._faults.swap:
                batch, self._held = [], item
            out += [self._damaged(data) for owner, data in batch if owner == connection]
        return [copy for data in out for copy in ([data, data] if self._rng.random() < self._faults.double else [data])]

    def _damaged(self, data: bytes) -> bytes:
        if self._rng.random() >= self._faults.damage:
            return data
        broken = bytearray(data)
        broken[self._rng.randrange(len(broken))] ^= 1 << self._rng.randrange(8)
        return bytes(broken)


class _Soak:
    def __init__(self, trace: Trace, seed: int, faults: Faults) -> None:
        self.rng = random.Random(seed)  # noqa: S311 - a simulation, not a secret
        self.faults, self.result, self.now_us = faults, SoakResult(), 0
        settings = LinkSettings(delay_us=20_000)
        self.down = _Wire(Link(trace, settings), self.rng, faults)
        self.up = _Wire(Link(None, settings), self.rng, faults)
        self.store: dict[tuple[int, int], int] = {}  # of the viewer: (frame, tile) -> LoDs
        self._connect()

    def run(self, duration_us: int) -> SoakResult:
        while self.now_us < duration_us:
            self._exchange()
            self.now_us = max(self.now_us, min(self._upcoming()))
            self._receive()
            self._timers()
            self._note_bounds()
        self._disconnect()
        return self.result

    def _connect(self) -> None:
        self.result.connections += 1
        self.server, self.client = ServerSession(now_us=self.now_us), ClientSession(now_us=self.now_us)
        self.link_state = MeasuredLink()
        self.queued = 0
        self.known: dict[tuple[int, int], int] = {}  # the store as known to the server
        self.frame, self.playing, self.reference = self.rng.randrange(FRAMES), True, 0
        self.frame_us = self.pose_us = self.now_us
        inventory = pack_inventory(InventoryEntry(f, t, lods) for (f, t), lods in self.store.items())
        hello = Hello(PROTOCOL_VERSION, INTRINSICS, Pose.identity(), resume="soak", inventory=inventory)
        self.client.hello(hello, now_us=self.now_us)
        self.end_us = self.now_us + round(self.rng.expovariate(self.faults.disconnects_per_s) * 1e6)
        self.control_us = self._later(self.faults.controls_per_s)

    def _disconnect(self) -> None:
        for session in (self.server, self.client):
            session.connection_lost("cut", now_us=self.now_us)
        self._drain()
        self.result.unsettled += self.queued
        if self.server.in_flight_bytes or self.server.queued_bytes:
            self.result.unsettled += 1

    def _later(self, per_s: float) -> int:
        return self.now_us + round(self.rng.expovariate(per_s) * 1e6)

    def _upcoming(self) -> list[int]:
        times = [self.server.next_timer_us(), self.client.next_timer_us(), self.down.link.next_delivery_us()]
        times += [self.up.link.next_delivery_us(), self.end_us, self.control_us, self.frame_us, self.pose_us]
        return [t for t in times if t is not None]

    def _exchange(self) -> None:
        number = self.result.connections
        for data in self.server.data_to_send(self.now_us):
            self.down.push(number, data, self.now_us)
        for data in self.client.data_to_send(self.now_us):
            self.up.push(number, data, self.now_us)
        self._drain()

    def _receive(self) -> None:
        number = self.result.connections
        for data in self.down.pop(number, self.now_us):
            self.client.receive(data, now_us=self.now_us)
        for data in self.up.pop(number, self.now_us):
            self.server.receive(data, now_us=self.now_us)
        self._drain()

    def _timers(self) -> None:
        for session in (self.server, self.client):
            due_us = session.next_timer_us()
            if due_us is not None and due_us <= self.now_us:
                session.handle_timer(now_us=self.now_us)
        if self.now_us >= self.pose_us:
            self.pose_us = self.now_us + POSE_US
            self.client.send_poses([PoseSample(self.now_us, Pose.identity())], now_us=self.now_us)
        if self.now_us >= self.frame_us:
            self.frame_us = self.now_us + FRAME_US
            self._plan()
        if self.now_us >= self.control_us:
            self.control_us = self._later(self.faults.controls_per_s)
            action = self.rng.choice(("play", "pause", "seek", "rate"))
            self.client.control(Control(action, self.rng.randrange(FRAMES), self.now_us), now_us=self.now_us)
        if self.now_us >= self.end_us or self.server.closed or self.client.closed:
            self._disconnect()
            self._connect()

    def _plan(self) -> None:
        if not self.playing or self.server.state.value != "open":
            return
        self.frame = (self.frame + 1) % FRAMES
        self.reference += 1
        reference = ReferenceFrame(self.frame, self.reference, Pose.identity(), INTRINSICS, False)
        self._queue(reference, 1500, 0, key="reference")
        for tile in range(TILES):
            held = self.known.get((self.frame, tile), 0)
            if held < LODS:
                size = self.rng.randrange(1, 12_000)
                sizes, crcs = (size,) * (LODS - held), (0,) * (LODS - held)
                self._queue(TileLayers(self.frame, tile, held, LODS, sizes, crcs), size * (LODS - held), 1)
        self._queue(FrameEnd(self.frame), 0, 1)

    def _queue(self, message: TileLayers | ReferenceFrame | FrameEnd, size: int, priority: int, key: str = "") -> None:
        deadline_us = None if isinstance(message, FrameEnd) else self.now_us + 400_000
        self.queued += 1
        outgoing = Outgoing(message, memoryview(ZEROS)[:size], priority, deadline_us, key or None)
        self.server.queue(outgoing, now_us=self.now_us)

    def _drain(self) -> None:
        while (event := self.server.next_event()) is not None:
            self.result.events[type(event).__name__] += 1
            self._on_server(event)
        while (client_event := self.client.next_event()) is not None:
            self.result.events[type(client_event).__name__] += 1
            self._on_client(client_event)

    def _on_server(self, event: ev.ServerEvent) -> None:
        match event:
            case ev.Joined(hello):
                self.known = {(t.frame, t.tile): t.lods for t in unpack_inventory(hello.inventory)}
                self.result.resumed_tiles += len(self.known)
                self.server.accept(Welcome("soak", FPS, FRAMES, resumed=bool(self.known)), now_us=self.now_us)
            case ev.ControlReceived(control):
                self.playing = {"play": True, "pause": False}.get(control.action, self.playing)
                self.frame = control.frame
                if control.action == "seek":
                    self.server.cancel(lambda _: True, now_us=self.now_us)
            case ev.Acknowledged(sample):
                self.link_state.on_ack(sample)
                self.server.rate_hint_bps = self.link_state.allowance_bps(self.now_us)
            case ev.Evicted(tiles):
                for tile in tiles:
                    self.known[tile.frame, tile.tile] = tile.lods
            case ev.Delivered(outgoing):
                self.queued -= 1
                self.result.messages += 1
                if isinstance(outgoing.message, TileLayers):
                    self.known[outgoing.message.frame, outgoing.message.tile] = outgoing.message.to_lod
            case ev.Dropped(_, reason):
                self.queued -= 1
                self.result.drops[reason] += 1
            case ev.Closed(code):
                self.result.endings[f"server: {code}"] += 1

    def _on_client(self, event: ev.ClientEvent) -> None:
        match event:
            case ev.TileReceived(message):
                key = (message.frame, message.tile)
                self.result.sent_again += self.store.get(key, 0) > message.from_lod
                self.store[key] = max(message.to_lod, self.store.get(key, 0))
                if len(self.store) > STORE_TILES:
                    frame, tile = next(iter(self.store))
                    del self.store[frame, tile]
                    self.client.report_evictions([InventoryEntry(frame, tile, 0)])
            case ev.Closed(code):
                self.result.endings[f"client: {code}"] += 1

    def _note_bounds(self) -> None:
        r = self.result
        r.max_queued_bytes = max(r.max_queued_bytes, self.server.queued_bytes)
        r.max_in_flight_bytes = max(r.max_in_flight_bytes, self.server.in_flight_bytes)
        r.max_partial_bytes = max(r.max_partial_bytes, self.client.partial_bytes)


def run_soak(trace: Trace, duration_us: int, seed: int = 1, faults: Faults | None = None) -> SoakResult:
    """Soak for ``duration_us`` of virtual time. Deterministic."""
    return _Soak(trace, seed, faults or Faults()).run(duration_us)
