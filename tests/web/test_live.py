"""The web client's source over a socket, to a real server: what is shown is the bundle, through seeks and losses."""

from __future__ import annotations

import json
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cags_common.bundle import BundlePlayer
from support.live_server import serving, stream_url
from support.moving_bundle import FRAMES, moving_library
from support.node import run_script, why_not

TOKEN = "a-word"


@pytest.mark.parametrize("whole", [True, False])
async def test_a_stream_is_the_bundle_through_seeks_and_a_lost_connection(
    whole: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``whole``: the clip is kept whole, by server and client alike."""
    if reason := why_not():
        pytest.skip(reason)
    if not whole:
        monkeypatch.setattr("cags_common.bundle.manifest.MAX_WHOLE_SPLATS", 0)
    library = moving_library(str(tmp_path / "clip.cags"), 3)
    player = BundlePlayer(library.reader)
    expected = [_decoded(player.frame(frame)) for frame in range(FRAMES)]
    (tmp_path / "expected.json").write_text(json.dumps(expected))
    async with serving(library, token=TOKEN) as (_, server):
        url = stream_url(server).replace("0.0.0.0", "127.0.0.1")
        await run_script("live", tmp_path, CAGS_SERVER=url, CAGS_TOKEN=TOKEN, CAGS_WHOLE=str(int(whole)))


def _decoded(frame: Any) -> dict[str, Any]:
    columns = {name: zlib.crc32(np.ascontiguousarray(array)) for name, array in frame.splats.arrays()}
    return {"ids": frame.ids.tolist(), "columns": columns}
