"""Who may open the page: requests must name this machine as their host, and WebSockets must come from the page itself.

A page on another site could otherwise reach a server on loopback through the visitor's browser (cross-site WebSocket
hijacking), or under a host name of its own that it points at 127.0.0.1 (DNS rebinding). Addresses cannot be rebound, so
any literal address is taken; names must be ``localhost`` or allowed by the user.
"""

from __future__ import annotations

import ipaddress

from aiohttp import web
from aiohttp.typedefs import Handler, Middleware

from cags_common.transport.hosts import host_allowed, same_host

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self' {socket}; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


def on_this_machine(peer: str) -> bool:
    """Whether ``peer``, the address of the other end of a connection, is a loopback address."""
    try:
        address = ipaddress.ip_address(peer)
    except ValueError:
        return False
    mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
    return (mapped or address).is_loopback


def same_origin(request: web.Request) -> bool:
    """Whether a WebSocket request comes from the page that this server gave out (or from no browser at all)."""
    origin = request.headers.get("Origin")
    return origin is None or same_host(origin, request.host)


def guard(names: frozenset[str]) -> Middleware:
    """Middleware that refuses foreign hosts and puts the security headers on every answer."""

    @web.middleware
    async def middleware(request: web.Request, handler: Handler) -> web.StreamResponse:
        if not host_allowed(request.host, names):
            raise web.HTTPForbidden(text=f"host {request.host!r} is not allowed; use localhost or --view-allow-host\n")
        response = await handler(request)
        if not response.prepared:
            response.headers["Content-Security-Policy"] = POLICY.format(socket=f"ws://{request.host}")
            response.headers["X-Content-Type-Options"] = "nosniff"
            response.headers["Referrer-Policy"] = "no-referrer"
            response.headers["Cross-Origin-Opener-Policy"] = "same-origin"
            response.headers["Cache-Control"] = "no-cache"
        return response

    return middleware
