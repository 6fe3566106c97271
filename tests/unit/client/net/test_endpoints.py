"""Addresses of several servers."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from cags_client.net import endpoints
from cags_common.errors import BundleError, ConfigError, NetworkError
from cags_protocol.wire.limits import MAX_TEXT_BYTES

A, B = "ws://a:1/stream", "ws://b:2/stream"


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Addresses that were tried; those that hold ``a`` do not answer."""
    tried: list[str] = []

    async def connect(url: str, **_: Any) -> str:
        tried.append(url)
        if "//a" in url:
            raise NetworkError(f"{url}: cannot connect")
        return url

    monkeypatch.setattr(endpoints.websocket, "connect", connect)
    return tried


async def test_the_first_server_that_answers_is_used_and_asked_first_after_a_loss(asked: list[str]) -> None:
    servers = endpoints.Endpoints(f"{A}, {B}")
    assert await servers.first() == B
    assert asked == [A, B]
    assert await servers.again(1) == B
    with pytest.raises(NetworkError):
        await servers.again(2)
    assert await servers.again(3) == B


async def test_before_the_first_session_each_attempt_is_for_the_next_server(asked: list[str]) -> None:
    c = "ws://c:3/stream"
    servers = endpoints.Endpoints(f"{A},{B},{c}")
    assert await servers.first() == B
    assert servers.others == 1
    assert await servers.again(0) == c
    assert servers.others == 0


async def test_if_none_answers_the_last_ones_reason_is_given(asked: list[str]) -> None:
    with pytest.raises(NetworkError, match="//a2"):
        await endpoints.Endpoints("ws://a1/stream,ws://a2/stream").first()
    assert asked == ["ws://a1/stream", "ws://a2/stream"]


@pytest.mark.parametrize(
    "url",
    [
        *("", "http://a/stream", "ws://a/stream,", "a:80", "ws://a:99999/x", "ws://[::1/x", "ws://a:0/x"),
        *("ws://a..b/x", "ws://a b/x", f"wss://{64 * 'a'}/x"),
    ],
)
def test_what_is_no_address_is_refused(url: str) -> None:
    with pytest.raises(NetworkError, match="no stream address"):
        endpoints.addresses(url)


def test_a_scene_is_named_to_every_server() -> None:
    assert endpoints.of_scene(f"{A}, {B}", "") == f"{A}, {B}"
    assert endpoints.of_scene(f"{A}, {B}", "a b&c") == f"{A}?scene=a+b%26c,{B}?scene=a+b%26c"
    with pytest.raises(NetworkError, match="is no stream address"):
        endpoints.of_scene("nonsense", "room")


@pytest.mark.parametrize("token", ["se\ncret", "secret\r\nX: y", "\x1b[0m", "sec\udcffret"])
def test_a_token_with_control_characters_is_refused_and_not_repeated(token: str) -> None:
    """A line break in it would be a header of its own."""
    for shown in (lambda: endpoints.Endpoints(A, token), lambda: endpoints.fetch_info(A, token)):
        with pytest.raises(ConfigError, match=r"token has the character U\+[0-9A-F]{4}, which") as refused:
            shown()
        assert str(refused.value).isprintable()
        assert "sec" not in str(refused.value)


def test_a_token_that_no_message_holds_is_refused() -> None:
    endpoints.Endpoints(A, "x" * MAX_TEXT_BYTES)
    with pytest.raises(ConfigError, match=f"token is longer than {MAX_TEXT_BYTES} bytes"):
        endpoints.Endpoints(A, "ю" * MAX_TEXT_BYTES)


@contextmanager
def answering(head: bytes, drop: bytes) -> Iterator[int]:
    """A server of one connection that says ``head``, then ``drop`` ten times a second; yields its port."""
    listener = socket.create_server(("127.0.0.1", 0))
    over = threading.Event()

    def serve() -> None:
        with contextlib.suppress(OSError):
            sock, _ = listener.accept()
            with sock:
                sock.sendall(head)
                while not over.wait(0.1):
                    sock.sendall(drop)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield listener.getsockname()[1]
    finally:
        over.set()
        listener.close()
        thread.join()


HEAD = b"HTTP/1.1 200 OK\r\nContent-Length: 5000\r\n\r\n"


@pytest.mark.parametrize(("head", "drop"), [(HEAD, b"x"), (b"HTTP/1.1 200 OK\r\nX-Long: ", b"y")])
def test_a_server_that_answers_a_byte_at_a_time_is_given_up(
    monkeypatch: pytest.MonkeyPatch, head: bytes, drop: bytes
) -> None:
    monkeypatch.setattr(endpoints, "INFO_TIMEOUT_S", 0.5)
    began = time.monotonic()
    with answering(head, drop) as port, pytest.raises(NetworkError, match="takes longer than"):
        endpoints.fetch_info(f"ws://127.0.0.1:{port}/stream")
    assert time.monotonic() - began < 10


def test_a_shaper_without_a_server_hangs_up_and_what_to_do_is_told() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def hang_up() -> None:
            sock, _ = listener.accept()
            with sock:
                sock.recv(4096)

        thread = threading.Thread(target=hang_up)
        thread.start()
        told = r"; write wss:// if it has a certificate, and start the server behind it if it is a shaper or a proxy"
        with pytest.raises(NetworkError, match=f"the server hangs up without an answer{told}"):
            endpoints.fetch_info(f"ws://127.0.0.1:{listener.getsockname()[1]}/stream")
        thread.join()


def test_a_refusal_of_lists_in_lists_in_lists_is_a_refusal() -> None:
    head = b"HTTP/1.1 404 Not Found\r\nContent-Length: 90000\r\n\r\n" + b"[" * 90_000
    with answering(head, b"") as port, pytest.raises(NetworkError, match=r"404 Not Found for its bundle; check that"):
        endpoints.fetch_info(f"ws://127.0.0.1:{port}/stream")


def test_a_web_page_in_place_of_a_manifest_is_told_with_its_address() -> None:
    head = b"HTTP/1.1 200 OK\r\nContent-Length: 6\r\n\r\n<html>"
    with answering(head, b"") as port, pytest.raises(BundleError, match=f"{port}/stream: .* is not JSON .*; check the"):
        endpoints.fetch_info(f"ws://127.0.0.1:{port}/stream")
