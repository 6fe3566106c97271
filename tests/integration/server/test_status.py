"""What an operator sees, and who does not see it."""

from __future__ import annotations

import asyncio
import base64
import logging
import re
from typing import Any

import aiohttp
import pytest
from aiohttp.test_utils import TestServer

from cags_protocol import events as ev
from cags_server.http.status import SessionBook, page
from cags_server.records import StreamStats
from support.live_server import Client, serving


def basic(text: str) -> dict[str, str]:
    return {"Authorization": "Basic " + base64.b64encode(text.encode()).decode()}


async def told_of_frames(client: Client, http: aiohttp.ClientSession, server: TestServer) -> dict[str, Any]:
    """The report, once frames that ``client`` plays have been displayed."""
    async with asyncio.timeout(20):
        while True:
            await client.exchange()
            async with http.get(server.make_url("/status.json")) as answer:
                report: dict[str, Any] = await answer.json()
            if any(session["in_time"] + session["late"] for session in report["sessions"]):
                return report


async def test_the_page_and_the_log_tell_who_watches_and_why_others_left(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    async with serving() as (_, server), aiohttp.ClientSession() as http:
        async with http.get(server.make_url("/status")) as answer:
            assert "Nobody watches at the moment" in await answer.text()
        first, second = [await Client.join(server) for _ in range(2)]
        await first.until(ev.FrameEnded)
        await second.until(ev.FrameEnded)
        await first.leave()
        await second.play()
        report = await told_of_frames(second, http, server)
        async with http.get(server.make_url("/status")) as answer:
            assert "1 watching" in await answer.text()
            assert "default-src 'none'" in answer.headers["Content-Security-Policy"]
    (live,), (ended,) = report["sessions"], report["ended"]
    assert (live["session"], ended["session"]) == ("s2", "s1")
    assert live["frames"] > 0
    assert live["sent_mb"] > 0
    assert 0 < live["level"] <= live["levels"]
    assert (live["ended"], ended["ended"]) == ("", "bye: done")
    assert report["bundle"] == "wall"
    assert re.search(
        r"s1: left \(bye: done\) after \d s, data of 0 of 0 due frames in time, 0 stalls, short of", caplog.text
    )


@pytest.mark.parametrize("path", ["/status", "/status.json", "/metrics"])
@pytest.mark.parametrize(
    ("how", "status"),
    [
        ({}, 401),
        ({"headers": {"Authorization": "Bearer wrong"}}, 401),
        ({"headers": {"Authorization": "Basic ***"}}, 401),
        ({"headers": basic("anyone:wrong")}, 401),
        ({"headers": basic("anyone:secret")}, 200),
        ({"headers": {"Authorization": "Bearer secret"}}, 200),
    ],
)
async def test_with_a_token_it_is_for_those_who_have_it(path: str, how: dict, status: int) -> None:
    async with (
        serving(token="secret") as (_, server),
        aiohttp.ClientSession() as http,
        http.get(server.make_url(path), **how) as answer,
    ):
        assert answer.status == status
        assert ("WWW-Authenticate" in answer.headers) == (status == 401)


def test_what_peers_say_is_no_markup() -> None:
    book = SessionBook()
    book.began("s1", "<script>")
    text = page(book.report([("s1", StreamStats())]), "<b>")
    assert "<script>" not in text
    assert "&lt;script&gt;" in text
    assert "<b>" not in text


def test_the_book_forgets_the_oldest() -> None:
    book = SessionBook()
    for number in range(60):
        book.began(f"s{number}", "a")
        book.ended(f"s{number}", StreamStats(), ev.Closed("bye", "done"))
    report = book.report([])
    assert len(report["ended"]) == 50
    assert report["ended"][0]["session"] == "s59"
