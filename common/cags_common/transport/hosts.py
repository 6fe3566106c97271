"""Hosts and ports as addresses and HTTP headers write them."""

from __future__ import annotations

import ipaddress
from urllib.parse import urlsplit

from cags_common.errors import ConfigError

_NOT_IN_HOSTS = frozenset(" /?#@[]")


def host_port(host: str, port: int) -> str:
    """``HOST:PORT`` as addresses write it: IPv6 in brackets."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def is_host(name: str) -> bool:
    """Whether ``name`` can be looked up: Python's own functions raise other errors than ``OSError`` for the rest, such
    as names with an empty part or of a part with over 63 letters.
    """
    try:
        name.encode("idna")
    except UnicodeError:
        return False
    return bool(name) and name.isprintable() and not _NOT_IN_HOSTS & {*name}


def check_listening(name: str, host: str) -> None:
    """Check the setting ``name``, a ``host`` to listen on. Raises :class:`ConfigError`."""
    if not is_host(host):
        raise ConfigError(f"{name} = {host!r} is no address; give 127.0.0.1 for this machine alone, or 0.0.0.0 for all")


def same_host(origin: str, host: str | None) -> bool:
    """Whether an ``Origin`` header, sent by a browser, names the page of this very ``Host`` header."""
    try:
        return bool(host) and urlsplit(origin).netloc == host
    except ValueError:  # brackets that do not close, and the like: no browser sends it
        return False


def named(text: str) -> frozenset[str]:
    """Host names of a comma-separated list."""
    return frozenset(name.strip().lower() for name in text.split(",") if name.strip())


def host_allowed(host: str | None, names: frozenset[str]) -> bool:
    """Whether a ``Host`` header (with or without a port) is ``localhost``, a literal address, or one of ``names``.

    A page can point a name of its own at any address (DNS rebinding), and then its ``Origin`` equals ``Host``. It
    cannot do so with an address, which is what the browser asked for.
    """
    try:
        name = urlsplit(f"//{host}").hostname if host else None
    except ValueError:
        return False
    return bool(name) and (name == "localhost" or name in names or _is_address(name))


def is_loopback(host: str) -> bool:
    """Whether a host to listen on is this machine's loopback, by name or address."""
    return host == "localhost" or (_is_address(host) and ipaddress.ip_address(host).is_loopback)


def _is_address(name: str | None) -> bool:
    try:
        ipaddress.ip_address(name or "")
    except ValueError:
        return False
    return True
