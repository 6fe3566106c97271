"""The web client plays a published folder from a plain host of files, by ranges: what is shown is the bundle."""

from __future__ import annotations

import gzip
import json
import zlib
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from aiohttp import web
from aiohttp.test_utils import TestServer

from cags_common.bundle import BundlePlayer
from cags_common.errors import ConfigError
from cags_encoder.bundles.publish import SOURCE_TAG, publish
from support.moving_bundle import FRAMES, write_moving
from support.node import run_script, why_not


@asynccontextmanager
async def hosting(folder: Path) -> AsyncIterator[str]:
    app = web.Application()
    app.router.add_static("/scene/", folder)
    server = TestServer(app)
    await server.start_server()
    try:
        yield f"http://{server.host}:{server.port}/scene/"
    finally:
        await server.close()


async def test_a_published_folder_shows_what_the_bundle_holds(tmp_path: Path) -> None:
    if reason := why_not():
        pytest.skip(reason)
    reader = write_moving(str(tmp_path / "clip.cags"), 4)
    player = BundlePlayer(reader)
    expected = [_decoded(player.frame(frame)) for frame in range(FRAMES)]
    (tmp_path / "expected.json").write_text(json.dumps(expected))
    publish(str(tmp_path / "clip.cags"), tmp_path / "site", None)
    async with hosting(tmp_path / "site") as url:
        await run_script("static", tmp_path, CAGS_FOLDER=url)


def _decoded(frame: Any) -> dict[str, Any]:
    columns = {name: zlib.crc32(np.ascontiguousarray(array)) for name, array in frame.splats.arrays()}
    return {"ids": frame.ids.tolist(), "columns": columns}


def test_files_are_named_by_what_they_hold_and_the_page_says_where_its_scene_is(tmp_path: Path) -> None:
    write_moving(str(tmp_path / "clip.cags"), 4)
    page = tmp_path / "page"
    page.mkdir()
    (page / "index.html").write_text("<!doctype html><html><head></head></html>")
    (page / "page.js").write_text("let a;")
    (page / "stamp").write_text("x")
    found = publish(str(tmp_path / "clip.cags"), tmp_path / "site", page)
    names = sorted(path.name for path in (tmp_path / "site").iterdir())
    assert found.page and found.files == len(names)
    assert SOURCE_TAG in (tmp_path / "site" / "index.html").read_text()
    table = json.loads((tmp_path / "site" / "manifest.json").read_text())
    named = {table["published"]["codebooks"], *(group["tiles"]["name"] for group in table["gofs"])}
    plain = ("index.html", "page.js", "manifest.json")
    assert set(names) == named | {*plain, *(f"{name}.gz" for name in plain)}
    for name in plain:
        assert (
            gzip.decompress((tmp_path / "site" / f"{name}.gz").read_bytes()) == (tmp_path / "site" / name).read_bytes()
        )
    for name in named:
        data = (tmp_path / "site" / name).read_bytes()
        assert name.endswith(f"-{zlib.crc32(data):08x}-{len(data):x}.bin")


def test_a_folder_that_holds_something_is_refused(tmp_path: Path) -> None:
    write_moving(str(tmp_path / "clip.cags"), 4)
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "mine").write_text("x")
    with pytest.raises(ConfigError, match="empty or a new folder"):
        publish(str(tmp_path / "clip.cags"), tmp_path / "site", None)
