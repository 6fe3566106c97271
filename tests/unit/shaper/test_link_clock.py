"""When a link's time begins."""

from __future__ import annotations

import asyncio

from cags_shaper.link import Link
from cags_shaper.link_clock import LinkClock
from cags_shaper.log import LogWriter, open_log
from cags_shaper.proxy import ShaperProxy
from cags_shaper.settings import ShaperSettings


class Wall:
    """A clock set by hand."""

    def __init__(self) -> None:
        self.us = 77_000_000

    def __call__(self) -> int:
        return self.us


def test_time_stands_until_it_is_begun_and_begins_once() -> None:
    wall = Wall()
    clock = LinkClock(wall)
    wall.us += 5
    assert (clock.begun, clock.now_us()) == (False, 0)
    clock.begin()
    wall.us += 7
    clock.begin()
    assert (clock.begun, clock.now_us()) == (True, 7)


async def test_a_proxys_links_begin_with_its_first_connection() -> None:
    """Once they began with the process, and a client met whatever its own start-up had left of the trace."""
    wall = Wall()
    proxy = ShaperProxy(("127.0.0.1", 1), Link(None), Link(None))
    address = await proxy.start("127.0.0.1", 0, wall)
    wall.us += 9_000_000
    assert proxy.downlink.now_us() == 0
    for later_us in (0, 3_000_000):
        wall.us += later_us
        reader, writer = await asyncio.open_connection(*address)
        await reader.read()  # nobody listens there: accepted, and hung up
        writer.close()
        assert (proxy.downlink.now_us(), proxy.uplink.now_us()) == (later_us, later_us)
    await proxy.close()


async def test_a_link_may_begin_before_anybody_comes() -> None:
    wall = Wall()
    proxy = ShaperProxy(("127.0.0.1", 1), Link(None), Link(None))
    await proxy.start("127.0.0.1", 0, wall)
    proxy.begin()
    wall.us += 4
    assert proxy.downlink.now_us() == 4
    await proxy.close()


async def test_the_log_waits_for_the_link(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("cags_shaper.log.INTERVAL_US", 1_000)
    wall = Wall()
    proxy = ShaperProxy(("127.0.0.1", 1), Link(None), Link(None))
    await proxy.start("127.0.0.1", 0, wall)
    path, stop = tmp_path / "log.jsonl", asyncio.Event()
    with open_log(str(path)) as file:
        following = asyncio.create_task(LogWriter(file, ShaperSettings()).follow(proxy, stop))
        await asyncio.sleep(0.05)
        assert path.read_text().count("\n") == 1, "the header"
        proxy.begin()
        await asyncio.sleep(0.05)
        stop.set()
        await following
    assert path.read_text().count("\n") >= 3, "the header and both directions"
    await proxy.close()
