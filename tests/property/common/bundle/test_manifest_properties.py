"""Manifests, codebooks and source frames: damaged ones raise the program's own errors, and never anything else."""

from __future__ import annotations

import contextlib
import json
from typing import Any

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cags_common.bundle import LodLayer, Manifest, SourceDelta
from cags_common.bundle.source import decode_source, encode_source
from cags_common.coding.packing import gunzip_bounded, gzip_bytes
from cags_common.errors import BundleError, CagsError
from cags_common.tiles.svq import CodebookSet
from support.codec_scenes import books, cloud

MANIFEST = Manifest("x", 30.0, 4, (0, 2), (9, 9), 0, ((0, 0, 0), (1, 1, 1)), (LodLayer("scale", 1),), (1.0,))
TABLE = json.loads(MANIFEST.to_json())
BOOKS = books((4, 2)).to_bytes()
SOURCE = encode_source(
    SourceDelta(np.arange(0, 30, 3, dtype=np.int32), cloud(10), np.array([1, 2], np.int32)).keeping(np.arange(10) > 5)
)
QUICK = settings(max_examples=400, suppress_health_check=[HealthCheck.too_slow])

leaves = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8)
values = st.recursive(leaves, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner))


@given(st.sampled_from(sorted(TABLE)), values)
@QUICK
def test_any_value_in_any_field_is_read_or_refused(field: str, value: Any) -> None:
    with contextlib.suppress(BundleError):
        manifest = Manifest.from_json(json.dumps({**TABLE, field: value}).encode())
        assert Manifest.from_json(manifest.to_json()) == manifest


@given(st.binary(max_size=200))
@QUICK
def test_any_bytes_are_refused(data: bytes) -> None:
    with contextlib.suppress(BundleError):
        Manifest.from_json(data)
    with contextlib.suppress(CagsError):
        CodebookSet.from_bytes(data)
    with contextlib.suppress(CagsError):
        CodebookSet.from_bytes(BOOKS[:8] + gzip_bytes(data))
    with contextlib.suppress(CagsError):
        _ = decode_source(data, "x").splats


@given(st.integers(0, 2**31), st.integers(0, 255))
@QUICK
def test_one_wrong_byte_inside_is_read_or_refused(at: int, value: int) -> None:
    body = bytearray(gunzip_bounded(BOOKS[8:], 2**20, "x"))
    body[at % min(len(body), 64)] = value
    with contextlib.suppress(CagsError):
        CodebookSet.from_bytes(BOOKS[:8] + gzip_bytes(bytes(body)))
    source = bytearray(SOURCE)
    source[at % len(source)] = value
    with contextlib.suppress(CagsError):
        _ = decode_source(bytes(source), "x").splats
