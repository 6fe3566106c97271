"""Who may come in: origin, token, and how many at once."""

from __future__ import annotations

import hmac
import ssl

from cags_common.errors import ConfigError
from cags_common.transport.hosts import same_host
from cags_protocol.messages import Hello

HANDSHAKES_BEYOND_CLIENTS = 16
"""Connections that may be shaking hands while all places are taken."""


def origin_allowed(origin: str | None, host: str | None, allowed: str) -> bool:
    """Whether a page of ``origin`` may connect. Programs send none; pages of this very host may, and those listed.

    ``allowed`` is a comma-separated list of origins (``https://viewer.example``), or ``*``.
    """
    if origin is None or allowed.strip() == "*":
        return True
    if origin in {part.strip().rstrip("/") for part in allowed.split(",") if part.strip()}:
        return True
    return same_host(origin, host)


def token_allowed(expected: str, hello: Hello, header: str | None) -> bool:
    """Whether the token of the Hello, or of an ``Authorization: Bearer`` header, is the one asked for."""
    if not expected:
        return True
    shown = header.removeprefix("Bearer ") if header and header.startswith("Bearer ") else ""
    # Compared in constant time, both of them, so that nothing is learnt from how long a refusal takes.
    # Bytes of a header that are not UTF-8 come as lone surrogates.
    by_hello = hmac.compare_digest(hello.token.encode(), expected.encode())
    by_header = hmac.compare_digest(shown.encode(errors="surrogateescape"), expected.encode())
    return by_hello or by_header


def tls_context(certificate: str, key: str) -> ssl.SSLContext | None:
    """Context for the given PEM files; None without them. Raises :class:`ConfigError`."""
    if not certificate and not key:
        return None
    if not certificate or not key:
        raise ConfigError("tls-cert and tls-key belong together; give both files or neither")
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    try:
        context.load_cert_chain(certificate, key)
    except (OSError, ssl.SSLError) as error:
        raise ConfigError(f"tls-cert {certificate}, tls-key {key}: cannot be used ({error})") from error
    return context
