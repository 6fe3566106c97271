"""The page server, spoken to over real sockets on loopback."""

from __future__ import annotations

import asyncio
import json
import struct
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import aiohttp
import pytest

import cags_web
from cags_client.output.page import LiveView, ViewSettings, server
from cags_client.output.page.assets import MARK, NOT_BUILT
from cags_client.output.page.open_page import SLOW_WRITE_S, SLOW_WRITES
from cags_client.output.page.server import NO_ROOM, WRONG_TOKEN
from cags_client.output.page.shaper_control import ShaperControl
from cags_client.output.page.video import RAW
from cags_common.errors import ConfigError, NetworkError
from cags_common.geometry import Pose
from support.live_page import FRAMES, BallShow


@pytest.fixture
async def show() -> AsyncIterator[BallShow]:
    async with BallShow() as running:
        yield running


@pytest.fixture
async def client() -> AsyncIterator[aiohttp.ClientSession]:
    async with aiohttp.ClientSession() as session:
        yield session


class Visitor:
    """A page without a browser."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self.socket = socket

    async def say(self, **fields: Any) -> None:
        await self.socket.send_str(json.dumps(fields))

    async def told(self, kind: str) -> dict[str, Any]:
        """The next text of a kind; pictures before it are acknowledged."""
        while True:
            message = await self.socket.receive(timeout=10)
            assert message.type in (aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.BINARY), message
            if message.type is aiohttp.WSMsgType.BINARY:
                (length,) = struct.unpack_from(">I", message.data)
                await self.say(type="shown", number=json.loads(message.data[4 : 4 + length])["number"], key=False)
            elif json.loads(message.data)["type"] == kind:
                return dict(json.loads(message.data))

    async def frame(self, *, acknowledge: bool = True) -> dict[str, Any]:
        """Header of the next frame; its payloads' sizes are checked."""
        while True:
            message = await self.socket.receive(timeout=10)
            assert message.type in (aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.BINARY), message
            if message.type is not aiohttp.WSMsgType.BINARY:
                continue
            (length,) = struct.unpack_from(">I", message.data)
            header = dict(json.loads(message.data[4 : 4 + length]))
            listed = sum(item["bytes"] for item in header["pictures"] + header["overlays"]["grids"])
            assert len(message.data) == 4 + length + listed
            if acknowledge:
                await self.say(type="shown", number=header["number"], key=False)
            return header


async def visit(client: aiohttp.ClientSession, show: BallShow, **hello: Any) -> Visitor:
    visitor = Visitor(await client.ws_connect(show.view.url + "live"))
    await visitor.say(type="hello", **{"h264": True, **hello})
    return visitor


async def test_a_visitor_is_told_the_scene_and_sees_frames(show: BallShow, client: aiohttp.ClientSession) -> None:
    visitor = await visit(client, show)
    scene = await visitor.told("scene")
    assert (scene["name"], scene["frames"], scene["shaper"]) == ("bobbing balls", FRAMES, False)
    assert scene["settings"] == {
        "restorer": ["correct", "none"],
        "exactness": ["fast", "balanced", "exact"],
        "resolution": ["full", "half", "auto"],
    }
    assert "truth" in scene["pictures"]
    first = await visitor.frame()
    assert [p["name"] for p in first["pictures"]] == ["restored"]
    assert first["pictures"][0]["key"]
    assert first["pictures"][0]["codec"].startswith("avc1.")
    second = await visitor.frame()
    assert second["number"] == first["number"] + 1
    assert not second["pictures"][0]["key"]
    assert second["stages_ms"]["raster"] > 0


async def test_without_webcodecs_pictures_are_jpeg(show: BallShow, client: aiohttp.ClientSession) -> None:
    visitor = await visit(client, show, h264=False)
    assert (await visitor.frame())["pictures"][0]["codec"] == "jpeg"


async def test_a_page_on_this_machine_takes_pictures_as_they_are(
    show: BallShow, client: aiohttp.ClientSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    visitor = await visit(client, show, raw=True)
    picture = (await visitor.frame())["pictures"][0]
    assert (picture["codec"], picture["bytes"]) == ("i420", picture["width"] * picture["height"] * 3 // 2)
    monkeypatch.setattr("cags_client.output.page.server.on_this_machine", lambda peer: False)
    elsewhere = await visit(client, show, raw=True)
    assert (await elsewhere.frame())["pictures"][0]["codec"].startswith("avc1.")


async def test_a_line_that_cannot_carry_pictures_as_they_are_gets_them_coded(
    show: BallShow, client: aiohttp.ClientSession
) -> None:
    visitor = await visit(client, show, raw=True)
    assert (await visitor.frame())["pictures"][0]["codec"] == "i420"
    (page,) = show.view._pages.values()
    for seconds in (1.0, 1.0, 1.0, 1.0, 0.001, 1.0):  # no five in a row
        page.wrote(seconds)
    assert page.kind == RAW
    for _ in range(SLOW_WRITES):
        page.wrote(2 * SLOW_WRITE_S)
    while (picture := (await visitor.frame())["pictures"][0])["codec"] == "i420":
        pass
    assert picture["key"]


async def test_pictures_and_overlays_come_as_asked(show: BallShow, client: aiohttp.ClientSession) -> None:
    visitor = await visit(client, show)
    overlays = ["occlusion", "confidence", "detail", "tiles", "reference", "score"]
    await visitor.say(type="look", pictures=["truth", "depth"], overlays=overlays)
    header = await visitor.frame()
    while header["pictures"][0]["name"] != "truth":
        header = await visitor.frame()
    assert [picture["name"] for picture in header["pictures"]] == ["truth", "depth"]
    assert [grid["name"] for grid in header["overlays"]["grids"]] == ["occlusion", "confidence", "detail"]
    assert header["overlays"]["tiles"]
    assert header["overlays"]["reference"]
    assert header["stats"]["psnr_restored_db"] > header["stats"]["psnr_distorted_db"]


async def test_overlays_that_are_off_cost_nothing(show: BallShow, client: aiohttp.ClientSession) -> None:
    visitor = await visit(client, show)
    for _ in range(3):
        await visitor.frame()
    assert (show.controls.truths, show.controls.details) == (0, 0)


async def test_a_page_that_does_not_draw_is_not_sent_more(show: BallShow, client: aiohttp.ClientSession) -> None:
    visitor = await visit(client, show)
    await visitor.frame(acknowledge=False)
    last = await visitor.frame(acknowledge=False)
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.4):
            await visitor.frame()
    await visitor.say(type="shown", number=last["number"], key=True)
    assert (await visitor.frame())["pictures"][0]["key"]


async def test_the_pose_of_the_page_is_the_pose_of_the_picture(show: BallShow, client: aiohttp.ClientSession) -> None:
    visitor = await visit(client, show)
    await visitor.frame()
    await visitor.say(type="pose", at_us=5, position=[0, 0, -6], rotation=[1, 0, 0, 0])
    while (header := await visitor.frame())["pose_at_us"] != 5:
        pass
    assert header["camera"]["position"] == [0, 0, -6]
    assert show.view.poses.pose_at(0) == Pose((0, 0, -6), (1, 0, 0, 0))
    await visitor.say(type="set", name="held", value=False)
    while (await visitor.told("state"))["held"]:  # states told before the release may still be on their way
        pass


async def test_transport_and_settings_reach_the_client(show: BallShow, client: aiohttp.ClientSession) -> None:
    visitor = await visit(client, show)
    await visitor.told("state")
    await visitor.say(type="set", name="playing", value=False)
    await visitor.say(type="set", name="frame", value=900)
    await visitor.say(type="set", name="rate", value=0.5)
    await visitor.say(type="set", name="loop", value=False)
    await visitor.say(type="set", name="restorer", value="none")
    await visitor.say(type="set", name="resolution", value="half")
    await visitor.say(type="set", name="exactness", value="exact")
    while (state := await visitor.told("state"))["settings"]["exactness"] != "exact":
        pass
    assert state == {**state, "playing": False, "loop": False, "rate": 0.5}
    assert state["settings"] == {"restorer": "none", "resolution": "half", "exactness": "exact"}
    assert show.controls.frame == FRAMES - 1
    await visitor.say(type="set", name="playing", value=True)
    while not (await visitor.told("state"))["playing"]:
        pass


async def test_the_first_page_steers_and_the_next_one_after_it(show: BallShow, client: aiohttp.ClientSession) -> None:
    first, second = await visit(client, show), await visit(client, show)
    assert (await first.told("state"))["steers"]
    assert not (await second.told("state"))["steers"]
    await second.say(type="pose", at_us=1, position=[0, 0, -9], rotation=[1, 0, 0, 0])
    await second.say(type="set", name="playing", value=False)
    assert "another page steers" in (await second.told("error"))["text"]
    assert show.controls.playing
    assert not show.view.poses.held
    await first.say(type="pose", at_us=7, position=[0, 0, -6], rotation=[1, 0, 0, 0])
    while (await first.frame())["pose_at_us"] != 7:
        pass
    while (watched := await second.frame())["camera"]["position"] != [0, 0, -6]:
        pass
    assert watched["pose_at_us"] is None, "the time is of another page's clock"
    await first.socket.close()
    while not (await second.told("state"))["steers"]:
        pass
    assert (await second.frame())["pose_at_us"] is None, "the time is of the clock of a page that is gone"
    await second.say(type="pose", at_us=3, position=[0, 0, -9], rotation=[1, 0, 0, 0])
    while (await second.frame())["pose_at_us"] != 3:
        pass


async def test_pictures_are_drawn_for_the_window_of_the_page_that_steers(
    show: BallShow, client: aiohttp.ClientSession
) -> None:
    show.controls.windows.clear()
    first, second = await visit(client, show), await visit(client, show)
    await second.say(type="window", width=390, height=844)
    await first.say(type="window", width=1280, height=720)
    await first.say(type="window", width=1600, height=900)
    await first.socket.close()
    while not (await second.told("state"))["steers"]:
        pass
    await second.say(type="window", width=844, height=390)
    await second.say(type="set", name="rate", value=1.0)
    await second.told("state")
    assert show.controls.windows == [(1280, 720), (1600, 900), (390, 844), (844, 390)]


async def test_a_page_without_the_token_is_shown_nothing(client: aiohttp.ClientSession) -> None:
    async with BallShow(ViewSettings(view_port=0, view_token="sesame")) as show:
        for token, reason in ((None, "token needed"), ("wrong", "wrong token"), ("sésame", "wrong token")):
            visitor = await visit(client, show, **({} if token is None else {"token": token}))
            message = await visitor.socket.receive(timeout=10)
            assert (message.type, message.data, message.extra) == (aiohttp.WSMsgType.CLOSE, WRONG_TOKEN, reason)
            assert show.view.pages == 0
        welcome = await visit(client, show, token="sesame")
        assert (await welcome.told("scene"))["frames"] == FRAMES


def test_a_token_that_no_page_can_send_is_refused() -> None:
    with pytest.raises(ConfigError, match="printable"):
        ViewSettings(view_token="\udcff")


async def test_wishes_that_cannot_be_met_are_answered(show: BallShow, client: aiohttp.ClientSession) -> None:
    visitor = await visit(client, show)
    for name in ("restorer", "exactness", "resolution"):
        await visitor.say(type="set", name=name, value="magic")
        assert f"{name} = 'magic' must be one of" in (await visitor.told("error"))["text"]
    await visitor.say(type="set", name="delay_ms", value=10)
    assert "--shaper-control" in (await visitor.told("error"))["text"]


async def test_nonsense_closes_the_line_with_a_reason(show: BallShow, client: aiohttp.ClientSession) -> None:
    socket = await client.ws_connect(show.view.url + "live")
    await socket.send_str("nonsense")
    message = await socket.receive(timeout=10)
    assert message.type is aiohttp.WSMsgType.CLOSE
    assert message.data == 1008
    assert "JSON" in (message.extra or "")
    early = await client.ws_connect(show.view.url + "live")
    await early.send_str(json.dumps({"type": "set", "name": "playing", "value": True}))
    assert "hello" in ((await early.receive(timeout=10)).extra or "")


async def test_a_line_without_a_hello_is_closed_after_a_moment(
    show: BallShow, client: aiohttp.ClientSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "HELLO_S", 0.2)
    silent, page = await client.ws_connect(show.view.url + "live"), await visit(client, show)
    message = await silent.receive(timeout=10)
    assert (message.type, message.data) == (aiohttp.WSMsgType.CLOSE, 1008)
    assert "no hello within 0.2 s" in (message.extra or "")
    await asyncio.sleep(0.3)
    await page.frame()
    assert len(show.view._links) == 1


async def test_lines_without_a_hello_neither_pile_up_nor_keep_a_page_out(
    show: BallShow, client: aiohttp.ClientSession
) -> None:
    silent = [await client.ws_connect(show.view.url + "live") for _ in range(server.MAX_LINKS + 5)]
    assert len(show.view._links) == server.MAX_LINKS
    page = await visit(client, show)
    await page.told("scene")
    ended = [(await socket.receive(timeout=10)).type for socket in silent[:6]]
    assert all(kind in (aiohttp.WSMsgType.CLOSED, aiohttp.WSMsgType.ERROR) for kind in ended), "the oldest go"
    for socket in silent[6 : 6 + server.MAX_PAGES]:
        await socket.send_str(json.dumps({"type": "hello", "h264": True}))
    async with asyncio.timeout(10):
        while show.view.pages < server.MAX_PAGES:  # noqa: ASYNC110 - what is waited for lies in the server
            await asyncio.sleep(0.01)
    late = silent[5 + server.MAX_PAGES]
    assert (await late.receive(timeout=10)).data == NO_ROOM, "the ninth page"


async def test_a_page_too_many_is_told_why_and_the_others_go_on(
    show: BallShow, client: aiohttp.ClientSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "MAX_PAGES", 1)
    first, second = await visit(client, show), await visit(client, show)
    await first.frame()
    message = await second.socket.receive(timeout=10)
    assert (message.type, message.data, message.extra) == (aiohttp.WSMsgType.CLOSE, NO_ROOM, server.TOO_MANY)
    await first.frame()
    await first.socket.close()
    third = await visit(client, show)
    await third.told("scene")


async def test_a_token_of_half_a_character_is_refused_before_it_is_looked_at(
    show: BallShow, client: aiohttp.ClientSession, caplog: pytest.LogCaptureFixture
) -> None:
    visitor = await visit(client, show, token="\ud800")
    message = await visitor.socket.receive(timeout=10)
    assert (message.type, message.data) == (aiohttp.WSMsgType.CLOSE, 1008)
    assert "token must be" in (message.extra or "")
    assert caplog.text == ""


async def test_a_long_reason_ends_with_a_whole_character(show: BallShow, client: aiohttp.ClientSession) -> None:
    for letters in range(3):
        visitor = await visit(client, show)
        await visitor.say(type="set", name="x" * letters + "é" * 200, value=1)
        while (message := await visitor.socket.receive(timeout=10)).type is not aiohttp.WSMsgType.CLOSE:
            assert message.type in (aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.BINARY), message
        assert message.data == 1008
        assert "é" in (message.extra or "")


@pytest.fixture
def built(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A page as if it were built, of one line a file."""
    for name in cags_web.FILES:
        (tmp_path / name).write_text(f"<head></head>{name}")
    monkeypatch.setattr(cags_web, "page_folder", lambda: tmp_path)
    return tmp_path


@pytest.mark.parametrize("path", ["", "index.html", "page.css", "icon.svg", "page.js"])
@pytest.mark.usefixtures("built")
async def test_the_viewers_page_is_served_with_strict_headers(
    show: BallShow, client: aiohttp.ClientSession, path: str
) -> None:
    async with client.get(show.view.url + path) as response:
        assert response.status == 200
        assert "default-src 'none'" in response.headers["Content-Security-Policy"]
        assert response.headers["X-Content-Type-Options"] == "nosniff"
        name = path or "index.html"
        assert f"{response.content_type}; charset=utf-8".startswith(cags_web.FILES[name].partition(";")[0])
        mark = f"\n    {MARK}" if name == "index.html" else ""
        assert await response.text() == f"<head>{mark}</head>{name}"


async def test_where_the_page_is_not_built_it_says_how(
    show: BallShow, client: aiohttp.ClientSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cags_web, "page_folder", lambda: None)
    async with client.get(show.view.url) as response:
        assert (response.status, await response.text()) == (503, f"{NOT_BUILT}\n")
    assert cags_web.HOW_TO_BUILD in NOT_BUILT


@pytest.mark.parametrize(
    "path", ["none.js", "worker.js", "js/none.js", "page.js/..%2Fpage.css", "..%2F..%2Fx.py", "gallery.html"]
)
@pytest.mark.usefixtures("built")
async def test_nothing_else_is_served(show: BallShow, client: aiohttp.ClientSession, path: str) -> None:
    async with client.get(show.view.url + path) as response:
        assert response.status == 404


async def test_foreign_hosts_and_origins_are_refused(show: BallShow, client: aiohttp.ClientSession) -> None:
    async with client.get(show.view.url, headers={"Host": "evil.example"}) as response:
        assert response.status == 403
    with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
        await client.ws_connect(show.view.url + "live", origin="http://evil.example")
    assert refused.value.status == 403


async def test_a_page_that_cannot_listen_is_one_clear_line(show: BallShow) -> None:
    port = int(show.view.url.rstrip("/").rpartition(":")[2])
    for settings, told in (
        (ViewSettings(view_port=port), rf"view_port {port} .*\(address already in use\); give another --view-port"),
        (
            ViewSettings(view_host="192.0.2.1"),
            r"on 192\.0\.2\.1 .*requested address\); give --view-host",
        ),
    ):
        view = LiveView(settings, show.view.poses)
        with pytest.raises(NetworkError, match=told):
            await view.start()
        await view.stop()


async def test_the_address_is_one_that_a_browser_here_can_open(show: BallShow, client: aiohttp.ClientSession) -> None:
    for host, named in (("::1", "http://[::1]:"), ("0.0.0.0", "http://127.0.0.1:"), ("localhost", "http://127.0.0.1:")):
        view = LiveView(ViewSettings(view_host=host, view_port=0), show.view.poses)
        assert (await view.start()).startswith(named)
        try:
            async with client.get(view.url) as response:
                assert response.status == 200
        finally:
            await view.stop()


async def test_the_shaper_is_asked_over_its_control_port(client: aiohttp.ClientSession) -> None:
    asked: list[dict[str, Any]] = []

    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while line := await reader.readline():
            asked.append(json.loads(line))
            refused = asked[-1].get("delay_ms") == 7
            reply = {"ok": False, "error": "seven"} if refused else {"ok": True, "capacity_mbps": 9.0}
            writer.write(json.dumps(reply).encode() + b"\n")
        writer.close()

    server = await asyncio.start_server(answer, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    async with BallShow(ViewSettings(view_port=0, shaper_control=f"127.0.0.1:{port}")) as show:
        visitor = await visit(client, show)
        assert (await visitor.told("scene"))["shaper"]
        while (link := (await visitor.told("state"))["shaper"]) is None:
            pass
        assert link["capacity_mbps"] == 9.0
        await visitor.say(type="set", name="cap_mbps", value=4)
        await visitor.say(type="set", name="delay_ms", value=7)
        assert "seven" in (await visitor.told("error"))["text"]
        assert {"cap_mbps": 4.0} in asked
    server.close()
    await server.wait_closed()


async def test_a_dead_shaper_is_named() -> None:
    with pytest.raises(NetworkError, match="shaper control 127"):
        await ShaperControl("127.0.0.1:1").ask()
    for address in ("nowhere", "a..b:9001"):
        with pytest.raises(ConfigError, match="HOST:PORT"):
            ShaperControl(address)


def test_a_page_at_no_address_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"view_host = 'a\.\.b' is no address"):
        ViewSettings(view_host="a..b")


async def test_a_page_that_takes_nothing_does_not_keep_pictures_from_the_others(
    show: BallShow, client: aiohttp.ClientSession, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("cags_client.output.page.server.SLOW_PAGE_S", 0.2)
    stalled = await visit(client, show)
    await stalled.frame()
    (socket,) = show.view._pages

    async def hang(data: bytes) -> None:
        await asyncio.Event().wait()

    monkeypatch.setattr(socket, "send_bytes", hang)
    other = await visit(client, show)
    async with asyncio.timeout(5):
        for _ in range(20):
            await other.frame()
    assert socket not in show.view._pages
    assert "was let go" in caplog.text
