"""What there is to watch: the list, a scene's public manifest, and its thumbnail."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import asdict

from aiohttp import web

from cags_common.errors import CagsError
from cags_server.http.admission import header_allowed
from cags_server.http.page import SECURITY
from cags_server.scene.collection import Collection, UnknownSceneError

Answer = Callable[[web.Request], Awaitable[web.Response]]


def add_scenes(app: web.Application, scenes: Collection, token: str, *, upload_bytes: int) -> None:
    """Serve ``/scenes`` (where there are several), ``/bundle`` and ``/thumbnail`` to those who know the token.

    A scene is named by ``?scene=NAME``. ``upload_bytes``: of the largest file that is taken; 0: none is.
    """

    async def listed(request: web.Request) -> web.Response:
        found = [asdict(entry) for entry in scenes.entries()]
        return web.json_response({"scenes": found, "upload_bytes": upload_bytes}, headers=SECURITY)

    async def bundle(request: web.Request) -> web.Response:
        manifest = scenes.manifest(request.query.get("scene"))
        return web.Response(body=manifest.public_json(), content_type="application/json")

    async def thumbnail(request: web.Request) -> web.Response:
        data = await asyncio.to_thread(scenes.thumbnail, request.query.get("scene"))
        return web.Response(body=data, content_type="image/jpeg", headers=SECURITY)

    app.router.add_get("/bundle", guarded(bundle, token))
    app.router.add_get("/thumbnail", guarded(thumbnail, token))
    if scenes.several:
        app.router.add_get("/scenes", guarded(listed, token))


def guarded(answer: Answer, token: str) -> Answer:
    """``answer`` behind the token; what goes wrong is one line of JSON."""

    async def guarded(request: web.Request) -> web.Response:
        if not header_allowed(token, request.headers.get("Authorization")):
            return web.json_response({"error": "the token is missing or wrong"}, status=401)
        try:
            return await answer(request)
        except UnknownSceneError as error:
            return web.json_response({"error": str(error)}, status=404)
        except CagsError as error:
            return web.json_response({"error": str(error)}, status=503)

    return guarded
