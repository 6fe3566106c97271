"""The server's shell over real sockets: several clients, and every way of being turned away."""

from __future__ import annotations

import asyncio
import json
import logging
import re
import ssl
import threading
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path
from typing import Any

import aiohttp
import pytest
from aiohttp.test_utils import TestServer
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import NameOID

from cags_bench.network.clients import watch_all
from cags_bench.network.plot import plot_session
from cags_client.net.endpoints import Endpoints, fetch_info
from cags_common.errors import ConfigError, NetworkError
from cags_common.geometry import Pose
from cags_common.transport.websocket import connect
from cags_protocol import SUBPROTOCOL
from cags_protocol import events as ev
from cags_protocol.wire.encoding import encode
from cags_protocol.wire.limits import MAX_MESSAGE_BYTES
from cags_protocol.wire.messages import PoseSample, ReferenceKind
from cags_server.http import app as app_module
from cags_server.http.admission import tls_context
from cags_server.http.app import App
from cags_server.records import write_session
from cags_server.scene.collection import Collection
from cags_server.settings import ServeSettings
from support.live_server import Client, now_us, serving, stream_url
from support.server_scene import CLIENT, hello, library


async def watched_with_references(client: Client) -> None:
    """Watch the clip until more references came than the greeting's: a busy machine sends none of so short a clip."""
    async with asyncio.timeout(60):
        while sum(isinstance(event, ev.ReferenceReceived) for event in client.events) < 2:
            await client.play()


async def test_several_clients_watch_at_once_and_leave() -> None:
    async with serving() as (_, server):
        clients = [await Client.join(server) for _ in range(4)]
        await asyncio.gather(*(client.until(ev.ReferenceReceived) for client in clients))
        await asyncio.gather(*(watched_with_references(client) for client in clients))
        for client in clients:
            references = [e.message for e in client.events if isinstance(e, ev.ReferenceReceived)]
            pictures = [r.seq for r in references if r.kind != ReferenceKind.NOTHING]
            assert references[0].frame == 0, "the greeting's"
            assert pictures == list(range(1, len(pictures) + 1)), "each client has a video of its own"
            await client.leave()
        async with aiohttp.ClientSession() as http:
            for _ in range(200):
                async with http.get(server.make_url("/healthz")) as answer:
                    health = await answer.json()
                if health["clients"] == 0:
                    break
                await asyncio.sleep(0.02)
            async with http.get(server.make_url("/metrics")) as answer:
                page = await answer.text()
    assert health == {"status": "ok", "clients": 0}
    assert "cags_sessions_total 4" in page
    assert 'cags_sent_bytes_total{kind="reference"}' in page


async def test_who_was_never_let_in_is_not_counted_as_a_session() -> None:
    """A counter never falls: neither may the connections that come and go without a Hello."""
    async with (
        serving() as (_, server),
        aiohttp.ClientSession() as http,
        http.ws_connect(stream_url(server), protocols=(SUBPROTOCOL,)),
        http.get(server.make_url("/metrics")) as answer,
    ):
        page = await answer.text()
    assert "cags_sessions_total 0.0" in page
    assert "cags_sessions 0.0" in page


async def test_headless_clients_of_the_benchmark_watch_to_the_end() -> None:
    async with serving() as (_, server):
        clients = await watch_all(stream_url(server), CLIENT, 2)
    for client in clients:
        assert sorted(client.ends) == list(range(12))
        assert client.references


def self_signed(folder: Path) -> tuple[str, str]:
    """PEM files of a certificate for 127.0.0.1 and its key."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "127.0.0.1")])
    now = datetime.now(UTC)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(days=1))
        .not_valid_after(now + timedelta(days=1))
        .add_extension(x509.SubjectAlternativeName([x509.IPAddress(ip_address("127.0.0.1"))]), critical=False)
        .sign(key, hashes.SHA256())
    )
    paths = folder / "cert.pem", folder / "key.pem"
    paths[0].write_bytes(certificate.public_bytes(Encoding.PEM))
    paths[1].write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    return str(paths[0]), str(paths[1])


async def test_a_session_over_tls(tmp_path: Path) -> None:
    certificate, key = self_signed(tmp_path)
    app = App(Collection.of(library()), ServeSettings(bundle="in memory", reference_width=64, reference_height=48))
    server = TestServer(app.web_app(), host="127.0.0.1")
    await server.start_server(ssl=tls_context(certificate, key))
    url, what = f"wss://127.0.0.1:{server.port}/stream", {"max_message_bytes": MAX_MESSAGE_BYTES}
    try:
        trusting = ssl.create_default_context(cafile=certificate)
        client = Client(await connect(url, subprotocol=SUBPROTOCOL, tls=trusting, **what))
        await client.play()
        assert any(isinstance(event, ev.TileReceived) for event in client.events)
        await client.transport.close()
        with pytest.raises(NetworkError, match=r"certificate is not trusted .*--ca"):
            await connect(url, subprotocol=SUBPROTOCOL, **what)
        with pytest.raises(NetworkError, match="write wss://"):
            await connect(url.replace("wss", "ws"), subprotocol=SUBPROTOCOL, **what)
        assert (await asyncio.to_thread(fetch_info, url, "", certificate)).frames == 12
        with pytest.raises(NetworkError, match=r"certificate is not trusted .*--ca"):
            await asyncio.to_thread(fetch_info, url)
        with pytest.raises(NetworkError, match="write wss://"):
            await asyncio.to_thread(fetch_info, url.replace("wss", "ws"))
        with pytest.raises(ConfigError, match=r"ca = .*key\.pem: cannot be used"):
            fetch_info(url, "", key)
    finally:
        await app.drain()
        await server.close()
        app.close()


async def test_tls_at_a_plain_port_is_named() -> None:
    async with serving() as (_, server):
        url = stream_url(server).replace("ws://", "wss://")
        with pytest.raises(NetworkError, match=r"does not speak TLS there; .*write ws://"):
            await connect(url, subprotocol=SUBPROTOCOL, max_message_bytes=MAX_MESSAGE_BYTES)
        with pytest.raises(NetworkError, match=r"does not speak TLS there; .*write ws://"):
            await asyncio.to_thread(fetch_info, url)


async def test_one_place_is_one_client() -> None:
    async with serving(max_clients=1) as (_, server):
        first = await Client.join(server)
        await first.until(ev.Welcomed)
        second = await Client.join(server)
        (refused,) = await second.until(ev.Refused)
        assert refused.refusal.code == "full"


@pytest.mark.parametrize("how", [{"token": "secret"}, {"header_token": "secret"}])
async def test_the_token_opens_by_hello_or_header(how: dict[str, str]) -> None:
    async with serving(token="secret") as (_, server):
        assert await (await Client.join(server, **how)).until(ev.Welcomed)


@pytest.mark.parametrize("how", [{}, {"token": "Secret"}, {"header_token": "nonsense"}])
async def test_without_the_token_nobody_comes_in(how: dict[str, str]) -> None:
    async with serving(token="secret") as (_, server):
        (refused,) = await (await Client.join(server, **how)).until(ev.Refused)
        assert refused.refusal.code == "token"


async def test_another_version_is_refused_by_name() -> None:
    async with serving() as (_, server):
        transport = await connect(stream_url(server), subprotocol=SUBPROTOCOL, max_message_bytes=MAX_MESSAGE_BYTES)
        client = Client(transport)
        client.session.data_to_send(now_us())  # instead of this Hello, one of the future
        from dataclasses import replace

        await transport.send(encode(replace(hello(), version=99)))
        (refused,) = await client.until(ev.Refused)
        assert (refused.refusal.code, refused.refusal.field) == ("version", "version")


@pytest.mark.parametrize(
    ("origin", "allowed", "status"),
    [
        ("https://evil.example", "", 403),
        ("https://viewer.example", "https://viewer.example", 101),
        ("https://viewer.example", "*", 101),
        (None, "", 101),
        ("null", "", 403),
        ("http://[", "", 403),
    ],
)
async def test_pages_of_strange_origins_are_turned_away(origin: str | None, allowed: str, status: int) -> None:
    async with serving(origins=allowed) as (_, server), aiohttp.ClientSession() as http:
        headers = {} if origin is None else {"Origin": origin}
        try:
            async with http.ws_connect(stream_url(server), headers=headers, protocols=(SUBPROTOCOL,)):
                reached = 101
        except aiohttp.WSServerHandshakeError as error:
            reached = error.status
        assert reached == status


@pytest.mark.parametrize(
    ("hosts", "host", "status"),
    [
        ("", "rebound.example", 403),
        ("viewer.example", "Viewer.example", 200),
        ("", "127.0.0.1", 200),
        ("", "[::1]:7", 200),
    ],
)
async def test_a_name_that_a_stranger_points_here_reaches_nothing(hosts: str, host: str, status: int) -> None:
    """DNS rebinding: the page's ``Origin`` is its ``Host``."""
    async with serving(hosts=hosts) as (_, server), aiohttp.ClientSession() as http:
        for path in ("/bundle", "/metrics", "/healthz"):
            async with http.get(server.make_url(path), headers={"Host": host}) as answer:
                assert answer.status == status
        headers = {"Host": host, "Origin": f"http://{host}"}
        if status == 403:
            with pytest.raises(aiohttp.WSServerHandshakeError):
                await http.ws_connect(stream_url(server), headers=headers, protocols=(SUBPROTOCOL,))
        else:
            await (await http.ws_connect(stream_url(server), headers=headers, protocols=(SUBPROTOCOL,))).close()


@pytest.mark.parametrize("data", [b"", b"\x00" * 64, b"\x81\xa4type\xa5hello", bytes(range(256))])
async def test_nonsense_ends_in_a_refusal_and_the_server_lives(data: bytes) -> None:
    async with serving() as (_, server):
        transport = await connect(stream_url(server), subprotocol=SUBPROTOCOL, max_message_bytes=MAX_MESSAGE_BYTES)
        client = Client(transport)
        client.session.data_to_send(now_us())
        await transport.send(data)
        (refused,) = await client.until(ev.Refused)
        assert refused.refusal.code == "malformed"
        assert await (await Client.join(server)).until(ev.Welcomed)


async def test_a_client_that_floods_is_refused() -> None:
    async with serving(max_message_rate=50.0) as (_, server):
        client = await Client.join(server)
        await client.until(ev.Welcomed)
        for _ in range(200):
            client.session.send_poses([PoseSample(now_us(), Pose.identity())], now_us=now_us())
        (refused,) = await client.until(ev.Refused)
        assert (refused.refusal.code, refused.refusal.field) == ("quota", "messages")


async def test_a_silent_client_is_dropped() -> None:
    async with serving(idle_s=0.5) as (_, server):
        client = await Client.join(server)
        await client.until(ev.Welcomed)
        async with asyncio.timeout(10):
            while True:
                client.session.receive(await client.transport.recv(), now_us=now_us())
                events = iter(client.session.next_event, None)
                if any(isinstance(event, ev.Refused) and event.refusal.code == "timeout" for event in events):
                    break


async def test_draining_says_goodbye_and_lets_no_one_in() -> None:
    async with serving() as (app, server):
        client = await Client.join(server)
        await client.until(ev.FrameEnded)
        ending = asyncio.create_task(app.drain())
        (closed,) = await client.until(ev.Closed)
        await ending
        assert closed.reason == "the server is shutting down"
        with pytest.raises(NetworkError, match="503"):
            await Client.join(server)
        async with aiohttp.ClientSession() as http, http.get(server.make_url("/readyz")) as answer:
            assert answer.status == 503


async def test_the_bundle_is_described_before_the_stream() -> None:
    async with (
        serving() as (_, server),
        aiohttp.ClientSession() as http,
        http.get(server.make_url("/bundle")) as answer,
    ):
        manifest = json.loads(await answer.text())
    assert manifest["frames"] == 12
    assert manifest["gofs"] == []


@pytest.mark.parametrize(("shown", "status"), [(None, 401), ("wrong", 401), ("secret", 200)])
async def test_the_bundle_asks_for_the_token_too(shown: str | None, status: int) -> None:
    headers = {"Authorization": f"Bearer {shown}"} if shown else {}
    async with (
        serving(token="secret") as (_, server),
        aiohttp.ClientSession() as http,
        http.get(server.make_url("/bundle"), headers=headers) as answer,
    ):
        assert answer.status == status


async def test_a_client_shows_its_token_for_the_bundle() -> None:
    async with serving(token="secret") as (_, server):
        url = stream_url(server)
        assert (await asyncio.to_thread(fetch_info, url, "secret")).frames == 12
        with pytest.raises(NetworkError, match="--token"):
            await asyncio.to_thread(fetch_info, url)


@pytest.mark.parametrize("token", ["ключ", "schlüssel", "鍵🔑", "a b=c"])
async def test_a_token_of_any_letters_is_shown_by_the_client(token: str) -> None:
    async with serving(token=token) as (_, server):
        url = stream_url(server)
        assert (await asyncio.to_thread(fetch_info, url, token)).frames == 12
        transport = await Endpoints(url, token).first()
        client = Client(transport)
        assert await client.until(ev.Welcomed), "the header alone opens"
        with pytest.raises(NetworkError, match="the token is missing or wrong"):
            await asyncio.to_thread(fetch_info, url, token + "ю")


def files(folder: Path) -> list[Path]:
    return sorted(folder.iterdir())


async def test_a_session_is_logged(tmp_path: Path) -> None:
    async with serving(session_logs=str(tmp_path)) as (_, server):
        client = await Client.join(server)
        await client.play()
        await client.leave()
    (path,) = files(tmp_path)
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert lines[0]["format"] == "cags-session"
    assert all(line["reference_bytes"] >= 0 for line in lines[1:-1])
    assert lines[-1]["ending"]["code"] == "bye"


async def test_a_server_that_is_started_again_keeps_what_the_one_before_it_has_written(tmp_path: Path) -> None:
    """Both begin with session s1: the second once replaced the files of the first."""
    for _ in range(2):
        async with serving(session_logs=str(tmp_path / "logs"), event_traces=str(tmp_path / "traces")) as (_, server):
            client = await Client.join(server)
            await client.play()
            await client.leave()
    for folder in ("logs", "traces"):
        names = [path.name for path in files(tmp_path / folder)]
        assert len(names) == 2
        assert all(re.fullmatch(r"\d{8}T\d{6}Z-[0-9a-f]{4}-s1(\.events)?\.jsonl", name) for name in names)


async def test_every_step_of_sending_is_traced_and_can_be_drawn(tmp_path: Path) -> None:
    async with serving(event_traces=str(tmp_path)) as (_, server):
        client = await Client.join(server)
        await client.play()
        await client.transport.close()
        stranger = await connect(stream_url(server), subprotocol=SUBPROTOCOL, max_message_bytes=MAX_MESSAGE_BYTES)
        await stranger.close()
    (path,) = files(tmp_path)
    assert path.name.endswith("-s1.events.jsonl"), "one who never said hello leaves no file"
    header, *events = [json.loads(line) for line in path.read_text().splitlines()]
    assert header["trace"] == "cags-session"
    assert {"queued", "sent", "acked", "delivered", "closed"} <= {event["event"] for event in events}
    assert plot_session(path).exists()


async def test_a_session_is_logged_beside_the_loop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """8,192 records once stopped every stream for a quarter of a second, whenever somebody left."""
    threads, begun, slow = list[threading.Thread](), threading.Event(), threading.Event()

    def written(*arguments: Any) -> Path:
        threads.append(threading.current_thread())
        begun.set()
        assert slow.wait(10), "the event loop waits for the log"
        return write_session(*arguments)

    monkeypatch.setattr(app_module, "write_session", written)
    async with serving(session_logs=str(tmp_path)) as (_, server), aiohttp.ClientSession() as http:
        client = await Client.join(server)
        await client.play()
        await client.leave()
        assert await asyncio.to_thread(begun.wait, 10)
        async with http.get(server.make_url("/healthz")) as answer:
            assert (await answer.json())["clients"] == 0
        slow.set()
    assert threads != [threading.main_thread()]
    assert len(files(tmp_path)) == 1, "a server that drains writes its logs"


async def test_the_log_of_the_server_names_the_program_that_joins(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    async with serving() as (_, server):
        client = await Client.join(server, agent="cags-web 1.0")
        await client.until(ev.Welcomed)
        await client.leave()
    assert "s1: joined from 127.0.0.1 (cags-web 1.0)" in caplog.text


async def test_a_log_that_cannot_be_written_does_not_end_the_server(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    gone = tmp_path / "gone"
    gone.write_text("no folder")
    async with serving(session_logs=str(gone)) as (_, server):
        for _ in range(2):
            client = await Client.join(server)
            await client.play()
            await client.leave()
    assert caplog.text.count("gone: cannot be written") == 2
