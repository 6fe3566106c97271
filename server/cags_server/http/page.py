"""The viewer at ``/``: the built page, with headers that let it load nothing from elsewhere."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from aiohttp import web

import cags_web

SECURITY = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; worker-src 'self'; style-src 'self'; "
        "img-src 'self' blob:; connect-src 'self'; base-uri 'none'; form-action 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",  # asked for every time, answered by 304 while it is the same
}

NOT_BUILT = f"the viewer in the browser is not built, so / shows no scene; build it: {cags_web.HOW_TO_BUILD}"

_INSTEAD = f"""<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>cags-server</title><h1>This server streams, but its viewer is not built</h1>
<p>On the server's machine, in its checkout: <code>{cags_web.HOW_TO_BUILD}</code>, then load this page again.</p>
<p>Meanwhile <code>cags-client</code> plays <code>/stream</code> of this address.</p></html>"""


def add_page(app: web.Application, *, gallery: bool) -> None:
    """Serve the page at ``/`` and its parts beside it; with a ``gallery`` the page is that until a scene is named."""

    async def home(request: web.Request) -> web.StreamResponse:
        return await _file(request, "gallery.html" if gallery and "scene" not in request.query else "index.html")

    app.router.add_get("/", home)
    for name in cags_web.FILES:
        if not name.endswith(".html"):
            app.router.add_get(f"/{name}", partial(_file, name=name))


def why_missing() -> str | None:
    """Why there is no viewer at ``/``; None where there is one."""
    return None if cags_web.page_folder() else NOT_BUILT


def browsed(host: str) -> str:
    """The name to type where the server listens on ``host``: browsers give localhost what they give https."""
    return "localhost" if host in ("127.0.0.1", "::1", "0.0.0.0", "::") else host  # noqa: S104 - compared, not bound


async def _file(request: web.Request, name: str) -> web.StreamResponse:
    folder: Path | None = cags_web.page_folder()
    if folder is None:
        return web.Response(status=503, text=_INSTEAD, content_type="text/html", charset="utf-8", headers=SECURITY)
    return web.FileResponse(folder / name, headers={**SECURITY, "Content-Type": cags_web.FILES[name]})
