"""Tiles of every bundle format that this program reads decode to the numbers they were written down with."""

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cags_kernels
from cags_common.bundle.codecs import TileDecoder
from cags_common.bundle.manifest import VERSION, Manifest
from cags_common.errors import BundleError, DecodeError
from cags_common.tiles.dequantise import Dequantiser
from cags_common.tiles.payloads import decode_base
from cags_common.tiles.state import TileState
from cags_common.tiles.svq import CodebookSet
from cags_common.tiles.updates import UpdateState

FILES = sorted(Path(__file__).parent.glob("v*.json"))
CONTENTS = [json.loads(path.read_text(encoding="utf-8")) for path in FILES]
TILES = [(content, tile) for content in CONTENTS for tile in content["tiles"]]
LOGIT_TOLERANCE = 4e-6
"""Logarithms differ by an ulp between processors; everything else is exact."""


def raw(text: str) -> bytes:
    return base64.b64decode(text)


def check(state: TileDecoder, expected: dict[str, str]) -> None:
    assert state.ids.astype("<i4").tobytes() == raw(expected["ids"])
    for name, array in state.dequantise().arrays():
        wanted = np.frombuffer(raw(expected[name]), "<f4").reshape(array.shape)
        assert np.abs(array - wanted).max(initial=0) <= (LOGIT_TOLERANCE if name == "logit_opacities" else 0), name


@pytest.mark.parametrize("native", [False, True])
@pytest.mark.parametrize(("content", "tile"), TILES, ids=lambda value: value.get("name", ""))
def test_a_recorded_tile_decodes_as_recorded(content: dict[str, Any], tile: dict[str, Any], native: bool) -> None:
    if native and not cags_kernels.native_available():
        pytest.skip("needs the native kernels")
    info = Manifest.from_json(json.dumps(content["manifest"]).encode())
    books = CodebookSet.from_bytes(raw(content["codebooks"]))
    payloads = [raw(part) for part in tile["payloads"]]
    state = TileState(decode_base(payloads[0], books), Dequantiser(books, native=native), info.lod_order)
    lowest, highest = tile["decoded"]
    check(state, lowest)
    for lod in reversed(range(1, len(payloads))):
        state.add_layer(lod, payloads[lod])
    check(state, highest)


def test_a_recorded_update_decodes_as_recorded() -> None:
    for content in CONTENTS:
        books = CodebookSet.from_bytes(raw(content["codebooks"]))
        info = Manifest.from_json(json.dumps(content["manifest"]).encode())
        payloads = [raw(part) for part in content["update"]["payloads"]]
        state = UpdateState(payloads[0], books, info.lod_order)
        lowest, highest = content["update"]["values"]
        check_update(state, lowest)
        for lod in reversed(range(1, len(payloads))):
            state.add_layer(lod, payloads[lod])
        check_update(state, highest)
        assert state.lod == len(info.lod_order)


def check_update(state: UpdateState, expected: dict[str, dict[str, str]]) -> None:
    values = state.values()
    assert values.keys() == expected.keys()
    for column, change in values.items():
        rows = change.values
        assert change.ids.astype("<i4").tobytes() == raw(expected[column]["ids"])
        assert change.frames.tobytes() == raw(expected[column]["frames"])
        wanted = np.frombuffer(raw(expected[column]["rows"]), "<f4").reshape(rows.shape)
        assert np.abs(rows - wanted).max(initial=0) <= (LOGIT_TOLERANCE if column == "logit_opacities" else 0), column


def test_the_current_version_has_been_recorded() -> None:
    assert CONTENTS[-1]["version"] == VERSION


def test_other_versions_are_refused_by_number() -> None:
    fields, data = dict(CONTENTS[-1]["manifest"]), raw(TILES[-1][1]["payloads"][0])
    for version in (1, VERSION + 1):
        with pytest.raises(BundleError, match=f"version {version} is unknown; this program reads {VERSION}"):
            Manifest.from_json(json.dumps({**fields, "version": version}).encode())
    books = CodebookSet.from_bytes(raw(CONTENTS[-1]["codebooks"]))
    for version in (1, 11):
        with pytest.raises(DecodeError, match=f"version {version}, flags 0; this program reads 10"):
            decode_base(bytes([version]) + data[1:], books)
