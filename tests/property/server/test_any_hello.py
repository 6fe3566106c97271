"""Whatever a Hello says, as long as the protocol lets it through: it is refused in a line, or its client is served."""

from __future__ import annotations

from dataclasses import replace

from hypothesis import given, settings
from hypothesis import strategies as st

from cags_common.geometry import Intrinsics, Pose
from cags_common.tiles.inventory import InventoryEntry
from cags_protocol import ClientSession
from cags_protocol.wire.inventory import pack_inventory
from cags_protocol.wire.messages import Control, Hello
from cags_server.session.connection import Connection
from support.server_scene import SETTINGS, hello, library

SIDES = st.sampled_from([1, 2, 160, 16384]) | st.integers(1, 16384)
FOCALS = st.sampled_from([1e-3, 1.0, 300.0, 1e6]) | st.floats(1e-3, 1e6)
CENTRES = st.sampled_from([-1e6, 0.0, 80.0, 1e6]) | st.floats(-1e6, 1e6)
VIEWS = st.builds(Intrinsics, SIDES, SIDES, FOCALS, FOCALS, CENTRES, CENTRES)
PLACES = st.tuples(*[st.sampled_from([0.0, -3.0, 1e9]) | st.floats(-1e9, 1e9)] * 3)
TURNS = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: sum(c * c for c in q) > 0.01)
NEARS = st.sampled_from([1e-6, 0.2, 1e6]) | st.floats(1e-6, 1e6)
FRAMES = st.integers(0, 15) | st.integers(0, 2**31 - 1)  # the clip has twelve
TILES = st.integers(0, 40) | st.integers(0, 2**16 - 1)
HELD = st.lists(st.builds(InventoryEntry, FRAMES, TILES, st.integers(1, 64)), max_size=5)

LIBRARY = library()


@st.composite
def hellos(draw: st.DrawFn) -> Hello:
    return replace(
        hello(Pose(draw(PLACES), draw(TURNS))),
        intrinsics=draw(VIEWS),
        near=draw(NEARS),
        start_frame=draw(FRAMES),
        resume=draw(st.sampled_from(["", f"{LIBRARY.digest}-s9", "another-s1"])),
        inventory=pack_inventory(draw(HELD)),
    )


@settings(max_examples=60, deadline=None)
@given(hellos(), st.booleans())
def test_any_hello_is_refused_or_served(said: Hello, full_size: bool) -> None:
    full_size &= said.intrinsics.width_px * said.intrinsics.height_px < 100_000  # larger ones take seconds to draw
    connection = Connection(LIBRARY, replace(SETTINGS, reference_full_size=full_size), name="s", now_us=0)
    client = ClientSession(now_us=0)
    client.hello(said, now_us=0)
    for data in client.data_to_send(0):
        connection.receive(data, 0)
    if connection.closed:
        assert connection.ending is not None
        assert connection.ending.code == "malformed"
        assert "\n" not in connection.ending.reason
        return
    for now_us in (0, 10_000, 900_000, 1_000_000):
        for data in connection.data_to_send(now_us):
            client.receive(data, now_us=now_us)
        if now_us == 10_000:
            client.control(Control("play", min(said.start_frame, 2**31 - 1), 1_000_000), now_us=now_us)
        for data in client.data_to_send(now_us):
            connection.receive(data, now_us)
        connection.handle_timer(now_us)
        job = connection.next_job(now_us)
        if job is not None:
            connection.job_done(job.run(), now_us)
    assert not connection.closed
    assert connection.stats.frames >= 1
