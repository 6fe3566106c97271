"""The web client's source over a socket, to a real server: what is shown is the bundle, through seeks and losses."""

from __future__ import annotations

import asyncio
import json
import os
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cags_common.bundle import BundlePlayer
from support.live_server import serving, stream_url
from support.moving_bundle import FRAMES, moving_library
from support.node import WEB, node, why_not

TOKEN = "a-word"


async def test_a_stream_is_the_bundle_through_seeks_and_a_lost_connection(tmp_path: Path) -> None:
    if reason := why_not():
        pytest.skip(reason)
    library = moving_library(str(tmp_path / "clip.cags"), 3)
    player = BundlePlayer(library.reader)
    expected = [_decoded(player.frame(frame)) for frame in range(FRAMES)]
    (tmp_path / "expected.json").write_text(json.dumps(expected))
    async with serving(library, token=TOKEN) as (_, server):
        url = stream_url(server).replace("0.0.0.0", "127.0.0.1")
        await _node("live", tmp_path, CAGS_SERVER=url, CAGS_TOKEN=TOKEN)


def _decoded(frame: Any) -> dict[str, Any]:
    columns = {name: zlib.crc32(np.ascontiguousarray(array)) for name, array in frame.splats.arrays()}
    return {"ids": frame.ids.tolist(), "columns": columns}


async def _node(name: str, folder: Path, **environment: str) -> None:
    command = [*node(), "--test", "--test-reporter=spec", str(WEB / "tests" / "core" / f"{name}.test.ts")]
    process = await asyncio.create_subprocess_exec(
        *command,
        cwd=WEB,
        env={**os.environ, "CAGS_VECTORS": str(folder), **environment},
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.STDOUT,
    )
    try:
        output, _ = await asyncio.wait_for(process.communicate(), 120)
    except TimeoutError:
        process.kill()
        raise
    if process.returncode:
        pytest.fail(output.decode()[-6000:], pytrace=False)
