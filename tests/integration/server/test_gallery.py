"""A server of several scenes over HTTP: the list, each scene's own stream, and files that visitors bring."""

from __future__ import annotations

import asyncio
import contextlib
import threading
import zipfile
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from aiohttp import ClientError, ClientSession, web
from aiohttp.test_utils import TestServer

from cags_client.net.endpoints import fetch_info, of_scene
from cags_common.bundle import BundleReader
from cags_common.errors import BundleError, ConfigError, NetworkError
from cags_common.raster import create
from cags_encoder.formats import write_splats
from cags_server.http.app import App
from cags_server.http.gallery.archives import ArchiveError, unpacked
from cags_server.http.gallery.uploads import Uploads
from cags_server.scene.collection import Collection
from cags_server.settings import ServeSettings
from support.capture import three_balls
from support.live_server import Client, stream_url
from support.small_bundles import small_bundle

RASTERISER = create("auto")


@asynccontextmanager
async def gallery(folder: Path, **settings: Any) -> AsyncIterator[tuple[str, TestServer]]:
    """Address and server of the bundles in a folder."""
    async with served(folder, **settings) as (_, server):
        yield f"http://127.0.0.1:{server.port}", server


@asynccontextmanager
async def served(folder: Path, **settings: Any) -> AsyncIterator[tuple[App, TestServer]]:
    chosen = ServeSettings(bundle=str(folder), reference_width=64, reference_height=48, **settings)
    app = App(Collection.open(str(folder), lambda: RASTERISER, may_be_empty=chosen.accept_uploads), chosen)
    server = TestServer(app.web_app(), host="127.0.0.1")
    await server.start_server()
    try:
        yield app, server
    finally:
        await app.drain()
        await server.close()
        app.close()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scenes")
    small_bundle(folder / "one.cags")
    small_bundle(folder / "two.cags", frames=2, seed=6)
    return folder


async def test_scenes_have_addresses_of_their_own(folder: Path) -> None:
    async with gallery(folder) as (url, server), ClientSession() as http:
        listed = await (await http.get(f"{url}/scenes")).json()
        assert [scene["name"] for scene in listed["scenes"]] == ["one", "two"]
        assert listed["upload_bytes"] == 0
        for name, frames in (("one", 1), ("two", 2)):
            assert (await (await http.get(f"{url}/bundle", params={"scene": name})).json())["frames"] == frames
            picture = await http.get(f"{url}/thumbnail", params={"scene": name})
            assert picture.content_type == "image/jpeg"
            assert (await picture.read())[:2] == b"\xff\xd8"
            info = await asyncio.to_thread(fetch_info, of_scene(stream_url(server), name))
            assert info.frames == frames
        assert (await http.post(f"{url}/upload", data=b"x")).status == 404, "unless it was asked for"


async def test_a_scene_that_is_not_named_or_not_there_is_refused_in_a_line(folder: Path) -> None:
    async with gallery(folder) as (url, server), ClientSession() as http:
        for path in ("bundle", "stream", "thumbnail"):
            for query, words in (("", "a folder of scenes"), ("?scene=../one", "no scene '../one'")):
                answer = await http.get(f"{url}/{path}{query}")
                assert answer.status == 404
                assert words in (await answer.json())["error"]
        with pytest.raises(NetworkError, match="a folder of scenes"):
            await asyncio.to_thread(fetch_info, stream_url(server))


async def test_each_session_plays_its_own_scene(folder: Path) -> None:
    from cags_common.transport.websocket import connect
    from cags_protocol import SUBPROTOCOL
    from cags_protocol import events as ev
    from cags_protocol.wire.limits import MAX_MESSAGE_BYTES

    async with gallery(folder) as (_, server):
        for name, frames in (("one", 1), ("two", 2)):
            url = of_scene(stream_url(server), name)
            client = Client(await connect(url, subprotocol=SUBPROTOCOL, max_message_bytes=MAX_MESSAGE_BYTES))
            (welcomed,) = await client.until(ev.Welcomed)
            assert welcomed.welcome.frames == frames
            await client.transport.close()


async def test_the_list_needs_the_token_where_there_is_one(folder: Path) -> None:
    async with gallery(folder, token="sesame", accept_uploads=True) as (url, _), ClientSession() as http:
        for path in ("scenes", "bundle?scene=one", "thumbnail?scene=one", "upload"):
            assert (await http.get(f"{url}/{path}")).status == 401
            answer = await http.get(f"{url}/{path}", headers={"Authorization": "Bearer sesame"})
            assert answer.status == 200
        assert (await http.post(f"{url}/upload?name=a.ply", data=b"ply")).status == 401


# ---------------------------------------------------------------------------------------------------------- uploads


async def ended(http: ClientSession, url: str) -> dict[str, Any]:
    async with asyncio.timeout(120):
        while True:
            job: dict[str, Any] = await (await http.get(f"{url}/upload")).json()
            if job["state"] not in ("receiving", "encoding"):
                return job
            await asyncio.sleep(0.2)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def capture(path: Path) -> bytes:
    write_splats(path, three_balls(40, 5))
    return path.read_bytes()


async def test_a_file_becomes_a_scene(tmp_path: Path) -> None:
    data, folder = capture(tmp_path / "a.ply"), tmp_path / "scenes"
    folder.mkdir()
    async with gallery(folder, accept_uploads=True) as (url, _), ClientSession() as http:
        name = "../../My  plant\u202e.ply"
        answer = await http.post(f"{url}/upload", params={"name": name}, data=data)
        assert answer.status == 202
        assert (await http.post(f"{url}/upload?name=b.ply", data=data)).status == 409
        job = await ended(http, url)
        assert (job["state"], job["scene"]) == ("done", "My-plant"), job
        (scene,) = (await (await http.get(f"{url}/scenes")).json())["scenes"]
        assert (scene["title"], scene["frames"]) == ("My plant", 1)
    assert names(folder) == ["My-plant.cags"], "and nothing else is left"


async def test_what_cannot_be_encoded_is_told_in_a_line_and_leaves_nothing(tmp_path: Path) -> None:
    async with gallery(tmp_path, accept_uploads=True) as (url, _), ClientSession() as http:
        assert (await http.post(f"{url}/upload?name=bad.ply", data=b"ply\nnonsense")).status == 202
        job = await ended(http, url)
        assert job["state"] == "failed"
        assert "bad.ply" in job["text"]
        assert str(tmp_path) not in job["text"]
        for name, status in (("x.exe", 415), ("", 415)):
            answer = await http.post(f"{url}/upload", params={"name": name}, data=b"x")
            assert answer.status == status
            assert "known are .ply" in (await answer.json())["error"]
        strange = {"Origin": "https://elsewhere.example"}
        assert (await http.post(f"{url}/upload?name=a.ply", data=b"ply", headers=strange)).status == 403
    assert names(tmp_path) == []


@pytest.mark.parametrize(
    ("name", "title", "scene"),
    [
        ("Küche 2.PLY", "Küche 2", "K-che-2"),
        ("部屋.ply", "部屋", "scene"),
        ("a\"b'c%2F.ply", "a\"b'c%2F", "a-b-c-2F"),
        ("x:frames=3.ply", "x:frames=3", "x-frames-3"),
        ("...ply", "..", "scene"),
        (f"{'ü' * 300}.ply", "ü" * 120, "scene"),
    ],
)
async def test_names_are_shown_as_they_are_and_stored_in_plain_letters(
    name: str, title: str, scene: str, tmp_path: Path
) -> None:
    data, folder = capture(tmp_path / "a.ply"), tmp_path / "scenes"
    folder.mkdir()
    async with gallery(folder, accept_uploads=True) as (url, _), ClientSession() as http:
        assert (await http.post(f"{url}/upload", params={"name": name}, data=data[:-1])).status == 202
        job = await ended(http, url)
        assert job["text"].startswith(f"{title}.ply: is cut short"), job
        assert (await http.post(f"{url}/upload", params={"name": name}, data=data)).status == 202
        job = await ended(http, url)
        assert (job["text"], job["scene"]) == (f"{title} is ready", scene)
        (found,) = (await (await http.get(f"{url}/scenes")).json())["scenes"]
        assert (found["title"], found["name"]) == (title, scene)
    assert names(folder) == [f"{scene}.cags"]


async def test_a_frame_that_cannot_be_read_is_told_by_its_own_name(tmp_path: Path) -> None:
    frames = {"walk 1.ply": capture(tmp_path / "a.ply"), "clip/walk 2.ply": b"nonsense"}
    (tmp_path / "a.ply").unlink()
    data = archive(tmp_path / "frames.zip", frames).read_bytes()
    (tmp_path / "frames.zip").unlink()
    async with gallery(tmp_path, accept_uploads=True) as (url, _), ClientSession() as http:
        assert (await http.post(f"{url}/upload?name=frames.zip", data=data)).status == 202
        job = await ended(http, url)
        assert job["state"] == "failed"
        assert job["text"].startswith("walk 2.ply: ")
    assert names(tmp_path) == []


async def test_no_more_than_the_limit_is_received(tmp_path: Path) -> None:
    async def endless() -> AsyncIterator[bytes]:
        for _ in range(4):
            yield bytes(100_000)

    async with gallery(tmp_path, accept_uploads=True, upload_mb=0.2) as (url, _), ClientSession() as http:
        answer = await http.post(f"{url}/upload?name=a.ply", data=bytes(300_000))
        assert answer.status == 413
        assert (await http.post(f"{url}/upload?name=a.ply", data=endless())).status == 413
        assert (await ended(http, url))["state"] == "failed"
    assert names(tmp_path) == []


async def test_an_encoding_can_be_ended(tmp_path: Path) -> None:
    async with gallery(tmp_path, accept_uploads=True) as (url, _), ClientSession() as http:
        assert (await http.post(f"{url}/upload?name=a.ply", data=capture(tmp_path / "a.ply"))).status == 202
        job = await (await http.delete(f"{url}/upload")).json()
        assert (job["state"], job["text"]) == ("failed", "the upload was ended")
        assert names(tmp_path) == ["a.ply"]


class Trickle:
    """A body that begins, and goes on when it is let."""

    def __init__(self, first: bytes, rest: bytes = b"") -> None:
        self._parts, self.go_on = (first, rest), asyncio.Event()

    async def __aiter__(self) -> AsyncIterator[bytes]:
        yield self._parts[0]
        await self.go_on.wait()
        yield self._parts[1]


async def received(http: ClientSession, url: str) -> None:
    """Until a file is being received."""
    async with asyncio.timeout(10):
        while True:
            if (await (await http.get(f"{url}/upload")).json())["state"] == "receiving":
                return
            await asyncio.sleep(0.01)


async def test_a_file_that_is_being_received_can_be_ended_and_another_one_taken(tmp_path: Path) -> None:
    data = capture(tmp_path / "a.ply")
    async with gallery(tmp_path, accept_uploads=True) as (url, _), ClientSession() as http:
        body = Trickle(data[:100], data[100:])
        sending = asyncio.create_task(http.post(f"{url}/upload?name=a.ply", data=body))
        await received(http, url)
        job = await (await http.delete(f"{url}/upload")).json()
        assert (job["state"], job["text"]) == ("failed", "the upload was ended")
        assert names(tmp_path) == ["a.ply"], "nothing is left of it"
        answer = await http.post(f"{url}/upload?name=b.ply", data=data)
        assert answer.status == 202, "another one has the place"
        body.go_on.set()
        with contextlib.suppress(ClientError):  # the server need not read the rest
            answer = await sending
            assert answer.status == 409
            assert "ended" in (await answer.json())["error"]
        assert (await (await http.get(f"{url}/upload")).json())["text"] != "the upload was ended", (
            "which the late rest does not end"
        )


async def test_an_upload_that_is_ended_when_it_has_just_come_is_not_encoded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    came, receive = asyncio.Event(), Uploads._receive

    async def told(uploads: Uploads, request: web.Request, file: Path) -> None:
        await receive(uploads, request, file)
        came.set()

    monkeypatch.setattr(Uploads, "_receive", told)
    async with served(tmp_path, accept_uploads=True) as (app, server), ClientSession() as http:
        uploads, url = app._uploads, f"http://127.0.0.1:{server.port}"
        assert uploads is not None
        sending = asyncio.create_task(http.post(f"{url}/upload?name=a.ply", data=b"ply"))
        await came.wait()
        await uploads.end()
        assert (await sending).status == 409
        assert (uploads.job.state, uploads.job.text) == ("failed", "the upload was ended")
    assert names(tmp_path) == []


async def test_a_server_that_drains_takes_no_file_any_more(tmp_path: Path) -> None:
    async with served(tmp_path, accept_uploads=True) as (app, server), ClientSession() as http:
        body, url = Trickle(b"ply\n", b"x"), f"http://127.0.0.1:{server.port}"
        sending = asyncio.create_task(http.post(f"{url}/upload?name=a.ply", data=body))
        await received(http, url)
        async with asyncio.timeout(5):
            await app.drain()
        assert (await (await http.get(f"{url}/upload")).json())["state"] == "failed"
        body.go_on.set()
        with contextlib.suppress(ClientError):
            assert (await sending).status == 409
        answer = await http.post(f"{url}/upload?name=a.ply", data=b"ply")
        assert answer.status == 503
        assert "shutting down" in (await answer.json())["error"]
    assert names(tmp_path) == []


def test_uploads_need_a_folder_and_off_loopback_a_token(folder: Path) -> None:
    with pytest.raises(ConfigError, match="give a --token"):
        ServeSettings(bundle="x", host="0.0.0.0", accept_uploads=True)
    with pytest.raises(ConfigError, match="give a --token"):
        ServeSettings(bundle="x", hosts="scenes.example", accept_uploads=True)
    one = Collection.open(str(folder / "one.cags"), lambda: RASTERISER)
    with pytest.raises(ConfigError, match="is one bundle"):
        App(one, ServeSettings(bundle="x", accept_uploads=True))


# --------------------------------------------------------------------------------------------------------- archives


def archive(path: Path, files: dict[str, bytes], **options: Any) -> Path:
    with zipfile.ZipFile(path, "w", **options) as out:
        for name, data in files.items():
            out.writestr(name, data)
    return path


def test_frames_of_an_archive_are_numbered_by_their_names(tmp_path: Path) -> None:
    files = {
        "clip/10.ply": b"ten",
        "clip/2.ply": b"two",
        "__MACOSX/._2.ply": b"no",
        "../../3.ply": b"three",
        "a.txt": b"",
    }
    folder = unpacked(archive(tmp_path / "a.zip", files), tmp_path / "out", 1000)
    found = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert sorted(found.values()) == [b"ten", b"three", b"two"]
    assert [found[name] for name in sorted(found)].index(b"two") < [found[name] for name in sorted(found)].index(b"ten")
    assert set(found) == {"00000.ply", "00001.ply", "00002.ply"}
    alone = unpacked(archive(tmp_path / "b.zip", {"x.spz": b"one"}), tmp_path / "single", 1000)
    assert alone.read_bytes() == b"one"


@pytest.mark.parametrize(
    ("files", "told"),
    [
        ({"a.txt": b"x"}, "holds no frames"),
        ({"1.ply": b"x", "2.spz": b"x"}, "mixes .ply and .spz"),
        ({"1.ply": bytes(2000)}, "unpacks to 2000 bytes; at most 1000"),
    ],
)
def test_archives_that_are_no_sequence_or_too_large_are_refused(
    files: dict[str, bytes], told: str, tmp_path: Path
) -> None:
    bomb = archive(tmp_path / "a.zip", files, compression=zipfile.ZIP_DEFLATED)
    with pytest.raises(ArchiveError, match=told):
        unpacked(bomb, tmp_path / "out", 1000)


def test_a_lying_or_damaged_archive_is_refused(tmp_path: Path) -> None:
    whole = archive(tmp_path / "a.zip", {"1.ply": bytes(5000)}, compression=zipfile.ZIP_DEFLATED).read_bytes()
    at = whole.index(b"PK\x01\x02")
    lying = bytearray(whole)
    lying[at + 24 : at + 28] = (10).to_bytes(4, "little")  # its size, as the directory has it
    for number, data in enumerate((bytes(lying), whole[: len(whole) // 2], b"", b"PK" + bytes(50))):
        (tmp_path / f"{number}.zip").write_bytes(data)
        with pytest.raises(ArchiveError, match=r"\d\.zip|unpacks to more"):
            unpacked(tmp_path / f"{number}.zip", tmp_path / f"out{number}", 1000)


async def test_a_scene_that_cannot_be_opened_is_refused_in_a_line(
    folder: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def gone(reader: BundleReader) -> bytes:
        raise BundleError("two.cags: is not there any more")

    async with gallery(folder) as (url, _), ClientSession() as http:
        monkeypatch.setattr(BundleReader, "weights", gone)
        for _ in range(5):
            answer = await http.get(f"{url}/stream", params={"scene": "two"})
            assert answer.status == 503
            assert "cannot read the scene at present" in (await answer.json())["error"]
    assert 1 <= caplog.text.count("a scene cannot be opened: two.cags: is not there any more") < 5, "a line a second"
    assert "Traceback" not in caplog.text


async def test_a_scene_that_takes_long_to_open_holds_up_nobody(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked, gate = threading.Event(), threading.Event()

    def slow(reader: BundleReader) -> None:
        if reader.manifest.frames == 1:
            return
        asked.set()
        assert gate.wait(10), "the event loop waits for the store"

    async with gallery(folder) as (url, _), ClientSession() as http:
        monkeypatch.setattr(BundleReader, "weights", slow)
        opening = asyncio.create_task(http.get(f"{url}/stream", params={"scene": "two"}))
        assert await asyncio.to_thread(asked.wait, 10)
        assert (await http.get(f"{url}/stream", params={"scene": "one"})).status == 400, "open, but no WebSocket"
        assert not opening.done()
        gate.set()
        assert (await opening).status == 400
