"""Addresses of servers: finding one that answers, at the start and after a loss."""

from __future__ import annotations

import http.client
import json
import socket
import ssl
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from urllib.parse import urlencode, urlsplit

from cags_common.bundle.manifest import MAX_MANIFEST_BYTES, Manifest
from cags_common.errors import BundleError, ConfigError, NetworkError
from cags_common.settings import check_printable
from cags_common.transport import Transport, websocket
from cags_common.transport.hosts import is_host
from cags_protocol.wire.limits import MAX_MESSAGE_BYTES, MAX_TEXT_BYTES, SUBPROTOCOL

INFO_TIMEOUT_S = 10.0
FIRST_TIMEOUT_S, AGAIN_TIMEOUT_S = 10.0, 1.5
"""An attempt's time: at the start, and after a loss, where another server may be quicker."""


def addresses(url: str) -> tuple[str, ...]:
    """The stream addresses in ``url``, which commas separate. Raises :class:`NetworkError` for what is none."""
    found = tuple(part.strip() for part in url.split(","))
    for address in found:
        if not _is_stream_address(address):
            raise NetworkError(f"{address}: is no stream address; write ws://HOST:PORT/stream")
    return found


def of_scene(url: str, scene: str) -> str:
    """``url`` for one scene of servers that have several. Raises :class:`NetworkError` for what is no address."""
    if not scene:
        return url
    named = (urlsplit(address)._replace(query=urlencode({"scene": scene})) for address in addresses(url))
    return ",".join(address.geturl() for address in named)


def _is_stream_address(text: str) -> bool:
    try:
        parts = urlsplit(text)
        return parts.scheme in ("ws", "wss") and is_host(parts.hostname or "") and parts.port != 0
    except ValueError:  # a port beyond 65535, brackets that do not close
        return False


def check_token(token: str) -> None:
    """Raise :class:`ConfigError` for a token that no server can have, or that a header or a Hello cannot hold."""
    check_printable("token", token)
    if len(token.encode()) > MAX_TEXT_BYTES:
        raise ConfigError(f"token is longer than {MAX_TEXT_BYTES} bytes; give the server's with --token")


class Endpoints:
    """Opens connections to one of several servers of the same scene."""

    def __init__(self, url: str, token: str = "", ca: str = "") -> None:
        """``url``: one or more addresses, separated by commas. ``ca``: as for :func:`trust`.

        Raises :class:`NetworkError` and :class:`ConfigError` for what is no address, token or file of certificates.
        """
        check_token(token)
        self._urls, self._token, self._tls = addresses(url), token, trust(ca)
        self._current = 0

    async def first(self) -> Transport:
        """A connection to the first server that answers. Raises :class:`NetworkError`, the last one's."""
        for index in range(len(self._urls)):
            self._current = index
            try:
                return await self._open(FIRST_TIMEOUT_S)
            except NetworkError:
                if index + 1 == len(self._urls):
                    raise
        raise AssertionError("there is at least one address")

    @property
    def others(self) -> int:
        """How many addresses :meth:`first` has left unasked."""
        return len(self._urls) - self._current - 1

    async def again(self, attempt: int) -> Transport:
        """A connection for the ``attempt``-th try (from 1) after a loss: the same server first, then the next.

        Attempt 0 is one before the first session, after a server that answered had no room: always the next server.
        Raises :class:`NetworkError`.
        """
        if attempt != 1:
            self._current = (self._current + 1) % len(self._urls)
        return await self._open(AGAIN_TIMEOUT_S if attempt else FIRST_TIMEOUT_S)

    async def _open(self, timeout_s: float) -> Transport:
        return await websocket.connect(
            self._urls[self._current],
            subprotocol=SUBPROTOCOL,
            max_message_bytes=MAX_MESSAGE_BYTES,
            timeout_s=timeout_s,
            token=self._token,
            tls=self._tls,
        )


def trust(ca: str) -> ssl.SSLContext | None:
    """Which certificates are believed: those of the authorities in the PEM file ``ca``; None: the system's.

    Raises :class:`ConfigError`.
    """
    if not ca:
        return None
    try:
        return ssl.create_default_context(cafile=ca)
    except (OSError, ssl.SSLError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ConfigError(f"ca = {ca}: cannot be used ({reason}); give a PEM file of certificates") from error


def fetch_info(url: str, token: str = "", ca: str = "") -> Manifest:
    """The public manifest of the first server of ``url`` that answers, by HTTP: walks are placed before a session.

    Raises :class:`NetworkError` where there is no such server, :class:`ConfigError` for a token that none can have,
    and :class:`BundleError` for another version's manifest.
    """
    check_token(token)
    last = NetworkError(f"{url}: no server answers")
    for address in addresses(url):
        try:
            return _info(address, token, trust(ca))
        except NetworkError as error:
            last = error
    raise last


def _info(url: str, token: str, tls: ssl.SSLContext | None) -> Manifest:
    parts = urlsplit(url)
    connection = http.client.HTTPConnection(str(parts.hostname), parts.port, timeout=INFO_TIMEOUT_S)
    if parts.scheme == "wss":
        connection = http.client.HTTPSConnection(str(parts.hostname), parts.port, timeout=INFO_TIMEOUT_S, context=tls)
    try:
        path = f"/bundle?{parts.query}" if parts.query else "/bundle"
        connection.connect()
        with _hung_up_after(INFO_TIMEOUT_S, connection.sock, url):
            shown = {"Authorization": f"Bearer {token}".encode()} if token else {}  # as text it would be Latin-1
            connection.request("GET", path, headers=shown)
            with connection.getresponse() as response:  # unread data would keep the socket open
                data = response.read(MAX_MANIFEST_BYTES + 1)
    except ssl.SSLError as error:
        raise NetworkError(f"{url}: {websocket.tls_fault(error)}") from error
    except http.client.RemoteDisconnected as error:
        hint = "" if parts.scheme == "wss" else "write wss:// if it has a certificate, and "
        why = f"the server hangs up without an answer; {hint}start the server behind it if it is a shaper or a proxy"
        raise NetworkError(f"{url}: {why}") from error
    except (OSError, http.client.HTTPException) as error:
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise NetworkError(f"{url}: no server answers ({reason}); start cags-server or check the address") from error
    finally:
        connection.close()
    if response.status == http.HTTPStatus.UNAUTHORIZED:
        raise NetworkError(f"{url}: the token is missing or wrong; give the server's with --token")
    if response.status == http.HTTPStatus.NOT_FOUND and (reason := _reason(data)):
        raise NetworkError(f"{url}: {reason}")
    if response.status != 200:
        answer = f"{response.status} {response.reason}".strip()
        raise NetworkError(f"{url}: the server answers {answer} for its bundle; check that cags-server listens there")
    try:
        return Manifest.from_json(data)
    except BundleError as error:
        raise BundleError(
            f"{url}: what answers is no cags-server of this version ({error}); check the address"
        ) from error


@contextmanager
def _hung_up_after(seconds: float, sock: socket.socket, url: str) -> Iterator[None]:
    """End the conversation over ``sock`` after so long, however little comes at a time: a socket's own timeout begins
    anew with every byte. Raises :class:`NetworkError` then.
    """
    late = threading.Event()

    def hang_up() -> None:
        late.set()
        socket.socket.shutdown(sock, socket.SHUT_RDWR)  # of TLS, too: what reads meets the end

    timer = threading.Timer(seconds, hang_up)
    timer.daemon = True
    timer.start()
    try:
        yield
    except (OSError, http.client.HTTPException):
        if not late.is_set():
            raise
    finally:
        timer.cancel()
    if late.is_set():
        raise NetworkError(f"{url}: the server takes longer than {seconds:g} s to describe its bundle; try again later")


def _reason(data: bytes) -> str:
    """What a server says of a refusal, in a line; empty where it says nothing."""
    try:
        table = json.loads(data)
    except (ValueError, RecursionError):
        return ""
    reason = table.get("error") if isinstance(table, dict) else None
    return reason[:500] if isinstance(reason, str) and reason.isprintable() else ""
