"""WebSocket transports with the send discipline of real-time media: aiohttp for the server, websockets for the client.

Nothing is compressed, no more than 8 KiB wait in the process and 16 KiB in the kernel, and keep-alive is left to the
session above. Measured on a link falling from 20 to 1.5 Mbps: 92 ms of median latency against seconds with the
libraries' defaults.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cags_common.errors import NetworkError
from cags_common.transport.base import ConnectionEndedError
from cags_common.transport.tcp import WRITE_BUFFER_BYTES, TcpInfo, tcp_info, tune_socket

if TYPE_CHECKING:
    import ssl

    from aiohttp import web
    from websockets.asyncio.client import ClientConnection

CLOSE_TIMEOUT_S = 1.0
"""How long a close waits for the peer's answer."""


class ServerWebSocket:
    """The server's end, on an aiohttp request: ``await ServerWebSocket.accept(request, ...)``."""

    def __init__(self, socket: web.WebSocketResponse, transport: Any, peer: str) -> None:
        self._ws, self._transport = socket, transport
        self.peer = peer

    @classmethod
    async def accept(cls, request: web.Request, *, subprotocol: str, max_message_bytes: int) -> ServerWebSocket:
        """Answer the upgrade. Raises aiohttp's ``HTTPBadRequest`` for what is not a WebSocket request, and
        :class:`ConnectionEndedError` where the client is gone already.
        """
        from aiohttp import web

        ws = web.WebSocketResponse(
            timeout=CLOSE_TIMEOUT_S,
            protocols=(subprotocol,),
            compress=False,
            max_msg_size=max_message_bytes + 1,  # of aiohttp: the first size that is refused
            writer_limit=0,  # wait for the transport after every message, not after every 256 KiB
        )
        try:
            await ws.prepare(request)
        except ConnectionError as error:
            raise ConnectionEndedError(f"{request.remote}: went away before its upgrade was answered") from error
        transport = request.transport
        if transport is not None:
            transport.set_write_buffer_limits(high=WRITE_BUFFER_BYTES)
            tune_socket(transport.get_extra_info("socket"))
        return cls(ws, transport, request.remote or "unknown")

    @property
    def response(self) -> web.WebSocketResponse:
        """What the request's handler returns in the end."""
        return self._ws

    async def send(self, data: bytes) -> None:
        """See :class:`Transport`."""
        try:
            await self._ws.send_bytes(data)
        except (ConnectionError, RuntimeError) as error:  # RuntimeError: a close frame has been sent
            raise ConnectionEndedError(f"{self.peer}: went away ({error})") from error

    async def recv(self) -> bytes:
        """See :class:`Transport`. A text message ends the connection: the protocol has none."""
        from aiohttp import WSMsgType

        message = await self._ws.receive()
        if message.type is WSMsgType.BINARY:
            return bytes(message.data)
        if message.type is WSMsgType.TEXT:
            await self._ws.close(code=1003, message=b"binary messages only")
            raise ConnectionEndedError(f"{self.peer}: sent text; the protocol is binary")
        detail = f" ({self._ws.exception()})" if message.type is WSMsgType.ERROR else ""
        raise ConnectionEndedError(f"{self.peer}: closed the connection{detail}")

    async def close(self, reason: str = "") -> None:
        """See :class:`Transport`."""
        await self._ws.close(message=_close_reason(reason))

    def abort(self) -> None:
        """See :class:`Transport`."""
        if self._transport is not None:
            self._transport.abort()

    def tcp_info(self) -> TcpInfo | None:
        """The kernel's figures for this connection, where there are any."""
        return None if self._transport is None else tcp_info(self._transport.get_extra_info("socket"))


class ClientWebSocket:
    """The client's end: ``await connect(url, ...)``."""

    def __init__(self, socket: ClientConnection, url: str) -> None:
        self._ws, self._url = socket, url
        self.peer = url

    async def send(self, data: bytes) -> None:
        """See :class:`Transport`."""
        from websockets.exceptions import ConnectionClosed

        try:
            await self._ws.send(data)
        except ConnectionClosed as error:
            raise ConnectionEndedError(f"{self._url}: {_why_closed(error)}") from error

    async def recv(self) -> bytes:
        """See :class:`Transport`."""
        from websockets.exceptions import ConnectionClosed

        try:
            data = await self._ws.recv(decode=False)
        except ConnectionClosed as error:
            raise ConnectionEndedError(f"{self._url}: {_why_closed(error)}") from error
        return bytes(data)

    async def close(self, reason: str = "") -> None:
        """See :class:`Transport`."""
        await self._ws.close(reason=_close_reason(reason).decode())

    def abort(self) -> None:
        """See :class:`Transport`."""
        self._ws.transport.abort()


def _as_header(text: str) -> str:
    """``text`` such that the library, which writes headers as Latin-1, writes UTF-8."""
    return text.encode().decode("iso-8859-1")


async def connect(
    url: str,
    *,
    subprotocol: str,
    max_message_bytes: int,
    timeout_s: float = 10.0,
    token: str = "",
    tls: ssl.SSLContext | None = None,
) -> ClientWebSocket:
    """Connect to ``url`` (``ws://`` or ``wss://``). Raises :class:`NetworkError`, which names the URL."""
    import ssl

    from websockets.asyncio.client import connect as websocket_connect
    from websockets.exceptions import InvalidHandshake, InvalidStatus, InvalidURI
    from websockets.typing import Subprotocol

    extra: dict[str, Any] = {"ssl": tls} if tls is not None and url.startswith("wss:") else {}
    try:
        ws = await websocket_connect(
            url,
            subprotocols=[Subprotocol(subprotocol)],
            compression=None,
            additional_headers={"Authorization": f"Bearer {_as_header(token)}"} if token else None,
            user_agent_header=None,
            proxy=None,
            open_timeout=timeout_s,
            close_timeout=CLOSE_TIMEOUT_S,
            ping_interval=None,  # the session has its own keep-alive
            max_size=max_message_bytes,
            write_limit=WRITE_BUFFER_BYTES,
            **extra,
        )
    except InvalidURI as error:
        raise NetworkError(f"{url}: is not a WebSocket address; give ws://HOST:PORT/stream") from error
    except InvalidStatus as error:
        raise NetworkError(f"{url}: {_why_refused(error)}") from error
    except (InvalidHandshake, EOFError) as error:
        other = "is it a cags-server?"
        if url.startswith("ws://"):
            other += " If it has a certificate, write wss://"
        raise NetworkError(f"{url}: does not speak WebSocket there ({error}); {other}") from error
    except ssl.SSLError as error:
        raise NetworkError(f"{url}: {tls_fault(error)}") from error
    except TimeoutError as error:
        raise NetworkError(f"{url}: no answer within {timeout_s:g} s; is the server running and reachable?") from error
    except OSError as error:
        raise NetworkError(f"{url}: cannot connect ({_os_reason(error)}); is the server running there?") from error
    tune_socket(ws.transport.get_extra_info("socket"))
    return ClientWebSocket(ws, url)


def tls_fault(error: ssl.SSLError) -> str:
    """Why TLS did not come about, and what would help."""
    import ssl

    if isinstance(error, ssl.SSLCertVerificationError):
        return f"its certificate is not trusted ({error.verify_message}); give its authority's PEM file with --ca"
    if error.reason in ("WRONG_VERSION_NUMBER", "RECORD_LAYER_FAILURE", "HTTP_REQUEST"):
        return "does not speak TLS there; without a certificate at the server, write ws://"
    return f"TLS failed ({error.reason or error})"


def _os_reason(error: OSError) -> str:
    """One reason: asyncio joins those of all addresses that a name has."""
    if isinstance(error, ConnectionRefusedError) or "Connect call failed" in str(error):
        return "connection refused"
    return error.strerror or str(error)


def _why_refused(error: Any) -> str:
    status = int(error.response.status_code)
    if status < 300:
        return "is a page and no stream; a server's stream is at ws://HOST:PORT/stream"
    text = bytes(error.response.body or b"")[:200].decode(errors="replace").strip()
    elsewhere = status == 404 and not text.startswith("{")  # a cags-server's own reasons are JSON
    hint = "; a server's stream is at ws://HOST:PORT/stream" if elsewhere else ""
    return f"refused with HTTP {status}" + (f" ({text.splitlines()[0]})" if text else "") + hint


def _why_closed(error: Any) -> str:
    frame = error.rcvd
    if frame is None:
        return "the connection broke without a close; the server may have gone away"
    return f"closed by the server ({frame.reason or frame.code})"


def _close_reason(reason: str) -> bytes:
    """A close frame holds 123 bytes of reason at most; characters are not cut in half."""
    return reason.encode()[:123].decode(errors="ignore").encode()
