"""The proxy rests between packets: a link that waits for its delay must not spin."""

import asyncio

from cags_shaper.link import Link, LinkSettings
from cags_shaper.link_clock import LinkClock
from cags_shaper.proxy import Piece, ShapedDirection
from cags_shaper.trace import open_trace


class Sink(asyncio.Transport):
    def is_closing(self) -> bool:
        return False

    def write(self, data: bytes) -> None:
        self.data = getattr(self, "data", b"") + data

    def can_write_eof(self) -> bool:
        return False


async def test_waiting_for_the_delay_costs_no_turns():
    calls = 0

    def clock() -> int:
        nonlocal calls
        calls += 1
        return int(asyncio.get_running_loop().time() * 1e6)

    link: Link[Piece] = Link(open_trace("generated:steady-30"), LinkSettings(delay_us=200_000))
    direction = ShapedDirection(link, LinkClock(clock))
    direction.clock.begin()
    sink = Sink()
    await direction._push(Piece(b"x" * 1000, sink))
    await asyncio.sleep(0.5)
    await direction.close()
    assert sink.data == b"x" * 1000
    assert calls < 50, "a busy loop asks for the time thousands of times"


async def test_a_connection_that_times_out_ends_like_one_that_is_reset():
    link: Link[Piece] = Link(None)
    direction = ShapedDirection(link, LinkClock(lambda: int(asyncio.get_running_loop().time() * 1e6)))
    reader = asyncio.StreamReader()
    reader.set_exception(TimeoutError(110, "Connection timed out"))
    await direction.carry(reader, Sink())
    await direction.close()
    assert link.counts.delivered_packets == 1  # the end of the stream
