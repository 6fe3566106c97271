"""Hosts and ports as addresses and HTTP headers write them."""

from __future__ import annotations

from urllib.parse import urlsplit


def host_port(host: str, port: int) -> str:
    """``HOST:PORT`` as addresses write it: IPv6 in brackets."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def same_host(origin: str, host: str | None) -> bool:
    """Whether an ``Origin`` header, sent by a browser, names the page of this very ``Host`` header."""
    try:
        return bool(host) and urlsplit(origin).netloc == host
    except ValueError:  # brackets that do not close, and the like: no browser sends it
        return False
