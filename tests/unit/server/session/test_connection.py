"""Server and client sessions joined back to back: the whole server core without IO."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import pytest

from cags_common.geometry import Intrinsics, Pose
from cags_common.tiles.inventory import InventoryEntry
from cags_protocol import ClientSession
from cags_protocol import events as ev
from cags_protocol.wire.encoding import encode
from cags_protocol.wire.inventory import pack_inventory
from cags_protocol.wire.messages import Control, FrameEnd, PoseSample, ReferenceFrame, RefusalCode, TileLayers
from cags_server.reference.job import FrameJob, FrameRender
from cags_server.reference.render_slots import RenderSlots
from cags_server.session.connection import Connection
from cags_server.session.streamer import MARK_EVERY_US, Streamer
from support.server_scene import FPS, SETTINGS, FakeReader, hello, library
from support.streamer_rig import Rig, of

STEP_US = 5_000


class Pair:
    """A connection and a client, exchanging everything every 5 ms of virtual time."""

    def __init__(self, resume: str = "", inventory: bytes = b"", **options: object) -> None:
        self.now_us = 0
        self.connection = Connection(library(), SETTINGS, name="s1", now_us=0, **options)
        self.client = ClientSession(now_us=0)
        self.client.hello(hello(resume=resume, inventory=inventory), now_us=0)
        self.events: list[ev.ClientEvent] = []

    def step(self) -> None:
        now = self.now_us
        timer = self.connection.next_timer_us()
        if timer is not None and timer <= now:
            self.connection.handle_timer(now)
        job = self.connection.next_job(now)
        if job is not None:
            self.connection.job_done(self.rendered(job), now)
        for data in self.connection.data_to_send(now):
            self.client.receive(data, now_us=now)
        self.client.handle_timer(now_us=now)
        for data in self.client.data_to_send(now):
            self.connection.receive(data, now)
        while (event := self.client.next_event()) is not None:
            self.events.append(event)
        self.now_us += STEP_US

    def rendered(self, job: FrameJob) -> FrameRender:
        return job.run()

    def run(self, ms: int) -> None:
        for _ in range(ms * 1000 // STEP_US):
            if self.now_us % 20_000 == 0 and self.events:
                self.client.send_poses([PoseSample(self.now_us, Pose.identity())], now_us=self.now_us)
            self.step()

    def of(self, kind: type) -> list:
        return [event for event in self.events if isinstance(event, kind)]


def test_a_jump_cancels_what_is_queued_but_for_codebooks_and_weights(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FakeReader, "codebooks", lambda _: bytes(3_000_000))
    monkeypatch.setattr(FakeReader, "weights", lambda _: bytes(100_000))
    pair = Pair()
    pair.run(20)
    assert not pair.of(ev.BlobReceived)
    pair.client.control(Control("seek", 8, pair.now_us), now_us=pair.now_us)
    pair.run(3000)
    assert [(b.name, len(b.data)) for b in pair.of(ev.BlobReceived)] == [("codebooks", 3_000_000), ("weights", 100_000)]


def test_a_client_joins_plays_to_the_end_and_leaves() -> None:
    pair = Pair()
    pair.run(100)
    assert pair.of(ev.Welcomed)[0].welcome.frames == 12
    assert [(b.name, b.data) for b in pair.of(ev.BlobReceived)] == [("codebooks", b"codebooks")]
    assert pair.of(ev.FrameEnded)[0].message == FrameEnd(0)
    pair.client.control(Control("play", 0, pair.now_us + 250_000), now_us=pair.now_us)
    pair.run(1000)
    references = [r.message for r in pair.of(ev.ReferenceReceived)]
    assert [r.frame for r in references] == [0, *range(12)], "the first greets"
    assert [e.message.frame for e in pair.of(ev.FrameEnded)] == list(range(12))
    pair.client.bye("done", now_us=pair.now_us)
    pair.run(20)
    assert pair.connection.closed
    assert pair.connection.ending is not None
    assert pair.connection.ending.code == "bye"
    assert pair.connection.next_timer_us() is None
    assert pair.connection.next_job(pair.now_us) is None


def test_whatever_was_sent_last_is_marked_soon_though_nothing_follows_it() -> None:
    """Clients show nothing beyond the newest mark: ends that went out right after one once waited for the next plan."""
    pair = Pair()
    pair.run(100)
    pair.client.control(Control("play", 0, pair.now_us + 250_000), now_us=pair.now_us)
    read, waits_since_us, longest_us = 0, None, 0
    for _ in range(300):
        pair.run(STEP_US // 1000)
        for event in pair.events[read:]:
            if isinstance(event, ev.MarkReceived):
                waits_since_us = None
            elif isinstance(event, ev.TileReceived | ev.FrameEnded):
                waits_since_us = waits_since_us or pair.now_us
        read = len(pair.events)
        longest_us = max(longest_us, pair.now_us - (waits_since_us or pair.now_us))
    assert len(pair.of(ev.FrameEnded)) == 12
    assert longest_us <= MARK_EVERY_US + STEP_US


@pytest.mark.parametrize(
    ("goodbye_after_ms", "due"),
    [(None, 3), (0, 4), (2000, 6)],
    ids=["lost", "goodbye", "goodbye that waited on the link, as the poses did"],
)
def test_what_was_due_after_the_last_pose_counts_where_the_client_says_goodbye(
    goodbye_after_ms: int | None, due: int
) -> None:
    """Of a clip's 30 displayed frames 29 were said to be due, wherever the goodbye came before another pose."""
    pair = Pair()
    pair.run(100)
    pair.client.control(Control("play", 0, pair.now_us + 200_000), now_us=pair.now_us)
    pair.run(200 + round(3e3 / FPS))
    for _ in range(round(1e6 / FPS) // STEP_US):  # and no more poses
        pair.step()
    connection, now_us = pair.connection, pair.now_us
    if goodbye_after_ms is None:
        connection.connection_lost("reset", now_us)
    else:
        late_us = goodbye_after_ms * 1000
        assert connection.streamer is not None
        t_us, arrival_us = connection.streamer._last_pose
        connection.streamer._last_pose = t_us, arrival_us + late_us
        pair.client.bye(now_us=now_us)
        for data in pair.client.data_to_send(now_us):
            connection.receive(data, now_us + late_us)
    assert connection.stats.frames_in_time + connection.stats.frames_late == due


def test_marks_come_in_order_and_before_the_references_that_name_them() -> None:
    pair = Pair()
    pair.run(100)
    pair.client.control(Control("play", 0, pair.now_us + 250_000), now_us=pair.now_us)
    pair.run(300)
    pair.client.control(Control("seek", 8, pair.now_us + 250_000), now_us=pair.now_us)
    pair.run(500)
    newest, named, restarts = 0, list[int](), 0
    for event in pair.events:
        if isinstance(event, ev.MarkReceived):
            assert event.message.number > newest, "those that the jump took back leave gaps"
            newest, restarts = event.message.number, restarts + event.message.restart
        elif isinstance(event, ev.ReferenceReceived):
            assert event.message.basis <= newest
            named.append(event.message.basis)
    assert named == sorted(set(named)), "each has a mark of its own"
    assert len(named) > 8
    assert restarts == 1


def test_after_a_restart_comes_nothing_that_was_chosen_before_the_jump() -> None:
    pair = Pair()
    pair.run(100)
    pair.client.control(Control("play", 0, pair.now_us + 250_000), now_us=pair.now_us)
    pair.run(150)
    pair.client.control(Control("seek", 8, pair.now_us + 250_000), now_us=pair.now_us)
    pair.run(500)
    at = next(n for n, each in enumerate(pair.events) if isinstance(each, ev.MarkReceived) and each.message.restart)
    after = [each.message.frame for each in pair.events[at:] if isinstance(each, ev.TileReceived | ev.FrameEnded)]
    assert min(after) == 6, "the beginning of the group that was jumped to"


def test_a_jump_takes_back_what_waits_for_the_picture_before() -> None:
    pair = Pair()
    pair.run(100)
    connection, told = pair.connection, list[ev.Outgoing]()
    late = ev.Outgoing(TileLayers(0, 0, 1, 2, (10,), (0,)), bytes(10), 2)
    connection.session.queue(late, now_us=pair.now_us)
    settled = connection.streamer._on_settled
    connection.streamer._on_settled = lambda outgoing, delivered: (
        told.append(outgoing),
        settled(outgoing, delivered=delivered),
    )
    connection.receive(encode(Control("seek", 7, pair.now_us + 250_000)), pair.now_us)
    assert told == [late]


def test_two_runs_send_the_same() -> None:
    runs = []
    for _ in range(2):
        pair = Pair()
        pair.run(60)
        pair.client.control(Control("play", 0, pair.now_us + 250_000), now_us=pair.now_us)
        pair.run(700)
        runs.append([(r.message, bytes(r.payload)) for r in pair.of(ev.ReferenceReceived) + pair.of(ev.TileReceived)])
    assert runs[0] == runs[1]


def test_a_refused_client_is_told_why() -> None:
    pair = Pair(admit=lambda hello: (RefusalCode.FULL, "", "16 clients are here already; try again later"))
    pair.run(30)
    assert pair.of(ev.Refused)[0].refusal.code == "full"
    assert pair.connection.closed
    assert pair.connection.streamer is None


@pytest.mark.parametrize(
    ("view", "full_size", "says"),
    [
        (Intrinsics(640, 480, 1e-3, 1e-3, 320, 240), False, "spans 180.00 degrees"),
        (Intrinsics(640, 480, 500, 500, -1e6, 240), False, "spans 179.9"),
        (Intrinsics(1, 1, 1.0, 1e6, 0.5, 0.5), False, "spans 5.7e-05 degrees"),
        (Intrinsics(16384, 16384, 8000, 8000, 8192, 8192), True, "16384x16384 cannot be coded"),
        (Intrinsics(1, 1, 1, 1, 0.5, 0.5), True, "1x1 cannot be coded"),
    ],
)
def test_a_view_that_cannot_be_drawn_is_refused_and_not_met_when_it_is_drawn(
    view: Intrinsics, full_size: bool, says: str
) -> None:
    connection = Connection(library(), replace(SETTINGS, reference_full_size=full_size), name="s", now_us=0)
    client = ClientSession(now_us=0)
    client.hello(replace(hello(), intrinsics=view), now_us=0)
    for data in client.data_to_send(0):
        connection.receive(data, 0)
    assert connection.ending is not None
    assert connection.ending.code == "malformed"
    assert says in connection.ending.reason


def test_any_other_view_is_drawn() -> None:
    for view in (Intrinsics(16384, 16384, 8000, 8000, 8192, 8192), Intrinsics(1, 1, 50, 0.01, 0.5, 0.5)):
        rig = Rig(joins=hello(intrinsics=view))
        assert of(ReferenceFrame, rig.greeting)
        rig.play()
        assert of(ReferenceFrame, rig.step())


def test_a_goodbye_of_the_server_reaches_the_client() -> None:
    pair = Pair()
    pair.run(50)
    pair.connection.close("the server is shutting down", pair.now_us)
    pair.run(20)
    assert pair.of(ev.Closed)[0].reason == "the server is shutting down"


def test_a_seek_drops_what_waits() -> None:
    pair = Pair()
    pair.run(60)
    pair.client.control(Control("play", 0, pair.now_us + 250_000), now_us=pair.now_us)
    pair.run(300)
    pair.client.control(Control("seek", 8, pair.now_us + 250_000), now_us=pair.now_us)
    pair.events.clear()
    pair.run(400)
    assert [e.message.frame for e in pair.of(ev.FrameEnded)] == [6, 7, 8, 9, 10, 11]


def test_a_lost_connection_ends_the_session() -> None:
    pair = Pair()
    pair.run(30)
    pair.connection.connection_lost("reset by peer", pair.now_us)
    assert pair.connection.closed
    assert pair.connection.ending.code == "lost"


def test_a_client_that_comes_back_is_not_sent_what_it_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FakeReader, "weights", lambda _: b"weights")
    pair = Pair()
    pair.run(100)
    name = pair.of(ev.Welcomed)[0].welcome.session
    again = Pair(resume=name, inventory=pack_inventory([InventoryEntry(0, tile, 2) for tile in range(3)]))
    again.run(100)
    assert again.of(ev.Welcomed)[0].welcome.resumed
    assert {t.message.tile for t in again.of(ev.TileReceived)} == {3}
    assert [b.name for b in again.of(ev.BlobReceived)] == ["weights"], "which may not have come before"
    assert again.of(ev.FrameEnded)[0].message == FrameEnd(0)


def test_what_is_held_of_another_bundle_is_ignored() -> None:
    pair = Pair(resume="0123456789ab-s1", inventory=b"whatever")
    pair.run(100)
    assert not pair.of(ev.Welcomed)[0].welcome.resumed
    assert {t.message.tile for t in pair.of(ev.TileReceived)} == {0, 1, 2, 3}


def test_a_damaged_inventory_is_refused() -> None:
    name = f"{library().digest}-s9"
    pair = Pair(resume=name, inventory=b"\xff\xff\xff")
    pair.run(100)
    assert pair.of(ev.Refused)[0].refusal.field == "inventory"


def test_a_client_that_goes_gives_its_place_at_the_renderer_back() -> None:
    slots = RenderSlots(workers=1)
    pair = Pair(render_slots=slots)
    pair.run(100)
    pair.client.control(Control("play", 0, pair.now_us + 250_000), now_us=pair.now_us)
    pair.run(150)
    assert slots._out == 0, "renders that came back"
    due_us = pair.connection.streamer.next_due_us()
    assert pair.connection.next_job(due_us) is not None
    assert slots._out == 1
    pair.connection.connection_lost("cut", due_us)
    pair.connection.release(due_us)
    pair.connection.release(due_us)
    assert slots._out == 0


class ColdReader(FakeReader):
    """A bundle in a store: what was not read into memory yet must not be asked for by the stream."""

    def __init__(self) -> None:
        self.known, self.reading = set[int](), True
        super().__init__()
        self.known.clear()
        self.reading = False

    def at_hand(self, frame: int) -> bool:
        return frame in self.known

    def removed_ids(self, frame: int):
        assert self.reading or frame in self.known
        self.known.add(frame)
        return super().removed_ids(frame)


class FetchingPair(Pair):
    """Reads from the store elsewhere; ``fetched`` are the frames that were."""

    def __init__(self) -> None:
        super().__init__(fetches=True)
        self.reader, self.fetched = ColdReader(), []
        self.connection._library = library(self.reader)

    def rendered(self, job: FrameJob) -> FrameRender:
        with self.elsewhere():
            return super().rendered(job)

    @contextmanager
    def elsewhere(self) -> Iterator[None]:
        """In an executor, where reading is right."""
        self.reader.reading = True
        yield
        self.reader.reading = False

    def read(self) -> None:
        frame = self.connection.next_fetch()
        if frame is not None:
            assert self.connection.next_fetch() is None, "one at a time"
            with self.elsewhere():
                self.connection.fetch(frame)
            self.connection.fetched(frame, self.now_us)
            self.fetched.append(frame)


def test_a_stream_waits_for_its_frames_to_be_read_and_asks_for_each_once() -> None:
    pair = FetchingPair()
    pair.run(100)
    assert pair.of(ev.Welcomed), "whoever waits for a picture has been let in"
    assert not pair.of(ev.FrameEnded)
    assert not pair.of(ev.TileReceived)
    pair.read()
    pair.run(100)
    assert [e.message.frame for e in pair.of(ev.FrameEnded)] == [0]
    pair.client.control(Control("play", 0, pair.now_us + 250_000), now_us=pair.now_us)
    for _ in range(200):
        pair.read()
        pair.run(5)
    assert [e.message.frame for e in pair.of(ev.FrameEnded)] == list(range(12))
    assert pair.fetched == sorted(set(pair.fetched))
    assert {0, 6} <= set(pair.fetched), "a group's first frame brings its others along"


def test_what_opens_the_next_group_is_read_once_and_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """A frame that cannot be read was asked for again and again."""
    pair = FetchingPair()
    pair.run(100)
    pair.read()
    monkeypatch.setattr(Connection, "_needed", lambda _: None)
    wanted: list[int | None] = [6, 6, None, 6]
    monkeypatch.setattr(Streamer, "next_opening", property(lambda _: wanted[0]))
    asked = []
    while wanted:
        asked.append(pair.connection.next_fetch())
        if asked[-1] is not None:
            pair.connection.fetched(asked[-1], pair.now_us)
        wanted.pop(0)
    assert asked == [6, None, None, 6]


def test_a_frame_that_was_read_for_somebody_else_meanwhile_opens_the_stream_too() -> None:
    """A client that joined while another's frame was being read waited for its first picture for ever."""
    pair = FetchingPair()
    pair.run(50)
    with pair.elsewhere():
        pair.connection._library.fetch(0)
    pair.read()
    pair.run(100)
    assert [e.message.frame for e in pair.of(ev.FrameEnded)] == [0]


def test_a_frame_that_could_not_be_read_ends_the_wait() -> None:
    pair = FetchingPair()
    pair.run(50)
    frame = pair.connection.next_fetch()
    assert frame == 0
    with pytest.raises(AssertionError):  # the store still fails: the shell ends this session
        pair.connection.fetched(frame, pair.now_us)
    assert pair.connection.next_fetch() is None
