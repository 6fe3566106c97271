"""Who may come in: origin, token, and how many at once."""

from __future__ import annotations

import base64
import hmac
import ssl
from pathlib import Path

from cags_common.errors import ConfigError
from cags_common.transport.hosts import host_allowed, is_loopback, named, same_host
from cags_protocol.wire.messages import Hello
from cags_server.settings import ServeSettings

MAX_HANDSHAKES = 64
"""WebSockets that may have shown neither a Hello nor the token: one more ends the oldest of them."""


def origin_allowed(origin: str | None, host: str | None, allowed: str, names: frozenset[str]) -> bool:
    """Whether a page of ``origin`` may connect. Programs send none; pages of this very host may, and those listed.

    ``allowed`` is a comma-separated list of origins (``https://viewer.example``), or ``*``. This host is ``localhost``,
    an address, or one of ``names``: any other name in ``Host`` may be a stranger's that he points here.
    """
    if origin is None or allowed.strip() == "*":
        return True
    if origin in {part.strip().rstrip("/") for part in allowed.split(",") if part.strip()}:
        return True
    return host_allowed(host, names) and same_host(origin, host)


def host_refusal(settings: ServeSettings, host: str | None) -> str | None:
    """Why a request for ``host`` is not answered, in a line; None where it is.

    A server on loopback answers to this machine's names alone, so that no page reaches it under a name of its own.
    Elsewhere it may have any name, unless the operator lists those that it has.
    """
    if not settings.hosts and not is_loopback(settings.host):
        return None
    if host_allowed(host, named(settings.hosts)):
        return None
    return f"host {str(host)[:100]!r} is not allowed; list it with --hosts"


def token_allowed(expected: str, hello: Hello, header: str | None) -> bool:
    """Whether the token of the Hello, or of an ``Authorization: Bearer`` header, is the one asked for."""
    by_hello, by_header = (
        _same(hello.token, expected),
        header_allowed(expected, header),
    )  # both are compared in any case
    return by_hello or by_header


def header_allowed(expected: str, header: str | None) -> bool:
    """Whether an ``Authorization: Bearer`` header alone opens: what is asked before there is a Hello.

    The token is UTF-8 on the wire, and ``header`` as aiohttp decodes it.
    """
    shown = header.removeprefix("Bearer ") if header and header.startswith("Bearer ") else ""
    return not expected or _same(shown, expected)


def operator_allowed(expected: str, header: str | None, peer: str) -> bool:
    """Whether somebody may see who watches: by the token, or from this very machine where there is none.

    A browser asks for a name and a password: any name, and the token.
    """
    if not expected:
        return is_loopback(peer)
    if header_allowed(expected, header):
        return True
    kind, _, shown = (header or "").partition(" ")
    try:
        password = base64.b64decode(shown.encode(errors="surrogateescape"), validate=True).decode().partition(":")[2]
    except ValueError:
        return False
    return kind.lower() == "basic" and _same(password, expected)


def _same(shown: str, expected: str) -> bool:
    """Whether ``shown`` is ``expected``, or one of several that commas separate.

    In constant time, so that nothing is learnt from how long a refusal takes. Bytes of a header that are not UTF-8 come
    as lone surrogates.
    """
    data, known = shown.encode(errors="surrogateescape"), expected.split(",")
    return sum([hmac.compare_digest(data, each.strip().encode()) for each in known]) > 0


MISMATCH = "KEY_VALUES_MISMATCH"
"""OpenSSL's word for a key of another certificate."""


def tls_context(certificate: str, key: str) -> ssl.SSLContext | None:
    """Context for the given PEM files; None without them. Raises :class:`ConfigError`."""
    if not certificate and not key:
        return None
    if not certificate or not key:
        raise ConfigError("tls-cert and tls-key belong together; give both files or neither")
    for flag, file in (("tls-cert", certificate), ("tls-key", key)):
        try:
            Path(file).read_bytes()
        except OSError as error:
            raise ConfigError(f"--{flag} {file}: cannot be read ({error.strerror}); give a PEM file") from error
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    try:
        context.load_cert_chain(certificate, key)
    except (OSError, ValueError) as error:
        reason = "they do not belong together" if getattr(error, "reason", "") == MISMATCH else "they are not PEM"
        raise ConfigError(
            f"--tls-cert {certificate}, --tls-key {key}: cannot be used ({reason}); give a certificate and its "
            "private key, both as PEM"
        ) from error
    return context
