"""The files of the live page: those of the viewer in the browser (``web/``), told that a client stands behind them."""

from __future__ import annotations

from functools import partial

from aiohttp import web

import cags_web

NOT_BUILT = f"the viewer in the browser is not built, so --view has no page to serve; build it: {cags_web.HOW_TO_BUILD}"
MARK = '<meta name="cags-client" content="live" />'
"""Tells the page that pictures come from a client at ``live``, and that it draws none itself."""

FILES = ("index.html", "page.js", "page.css", "icon.svg")
"""What is served: a page with a client behind it decodes no tiles, so it needs no worker."""


def why_missing() -> str | None:
    """Why there is no page to serve; None where there is one."""
    return None if cags_web.page_folder() else NOT_BUILT


def add_assets(app: web.Application) -> None:
    """Serve the page at ``/`` and its parts beside it."""
    app.router.add_get("/", partial(_file, name="index.html"))
    for name in FILES:
        app.router.add_get(f"/{name}", partial(_file, name=name))


async def _file(request: web.Request, name: str) -> web.Response:
    folder = cags_web.page_folder()
    if folder is None:
        raise web.HTTPServiceUnavailable(text=f"{NOT_BUILT}\n")
    body = (folder / name).read_bytes()
    if name == "index.html":
        body = body.replace(b"<head>", f"<head>\n    {MARK}".encode(), 1)
    kind, _, charset = cags_web.FILES[name].partition("; charset=")
    return web.Response(body=body, content_type=kind, charset=charset or None)
