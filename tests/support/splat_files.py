"""Small splats and files of them, built in code."""

from __future__ import annotations

import gzip
import io
import json
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard

from cags_common.splats import SH_REST_OF_DEGREE, Splats
from cags_encoder.formats.spz import HEADER as SPZ_HEADER
from cags_encoder.formats.spz import spz_bytes
from cags_encoder.formats.spz_header import MAGIC, SpzHeader
from cags_encoder.formats.spz_streams import ENTRY, HEADER

SHARED_SCENES = Path(__file__).resolve().parents[3] / "shared" / "scenes"


def shared_scene(name: str) -> Path:
    """A scene of the shared data; the test is skipped where the data is absent."""
    path = SHARED_SCENES / name
    if not path.exists():
        pytest.skip(f"shared data is absent: {path}")
    return path


def random_splats(count: int = 60, degree: int = 1, seed: int = 0) -> Splats:
    """Plausible splats: a cloud of a metre or two."""
    rng = np.random.default_rng(seed)
    return Splats(
        means=rng.normal(size=(count, 3)).astype(np.float32),
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        log_scales=rng.uniform(-7, -2, (count, 3)).astype(np.float32),
        logit_opacities=rng.normal(0, 3, count).astype(np.float32),
        sh0=rng.normal(0, 0.8, (count, 3)).astype(np.float32),
        sh_rest=rng.normal(0, 0.2, (count, SH_REST_OF_DEGREE[degree], 3)).astype(np.float32),
    ).checked("random")


def zip_files(data: bytes) -> dict[str, bytes]:
    """Name and content of each file in a zip."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def zip_of(files: dict[str, bytes]) -> bytes:
    """A zip of ``files``, stored."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return out.getvalue()


def with_meta(sog: bytes, **changes: Any) -> bytes:
    """A SOG bundle whose ``meta.json`` has dotted fields replaced: ``with_meta(data, **{"means.mins": None})``."""
    files = zip_files(sog)
    meta = json.loads(files["meta.json"])
    for path, value in changes.items():
        *parents, last = path.split(".")
        table = meta
        for key in parents:
            table = table[key]
        table[last] = value
    return zip_of({**files, "meta.json": json.dumps(meta).encode()})


def gzipped(data: bytes) -> bytes:
    """``data`` as a gzip stream that does not depend on the clock."""
    return gzip.compress(data, mtime=0)


def spz_streams(header: SpzHeader, parts: dict[str, bytes], *, table: int = 32) -> bytes:
    """An SPZ file of version 4: a header, a table of sizes, and a zstd stream for each section."""
    packer = zstandard.ZstdCompressor(level=3)
    sections = [(parts[name], packer.compress(parts[name])) for name, width in header.sections if width]
    entries = b"".join(ENTRY.pack(len(packed), len(raw)) for raw, packed in sections)
    head = HEADER.pack(MAGIC, 4, header.count, header.sh_degree, header.fractional_bits, 0, len(sections), table)
    return head + bytes(table - 32) + entries + b"".join(packed for _, packed in sections)


def spz_parts(splats: Splats) -> tuple[SpzHeader, dict[str, bytes]]:
    """Header and sections of ``splats`` as our writer has them in version 3, which version 4 shares."""
    raw, at, parts = zlib.decompress(spz_bytes(splats), 31), 16, {}
    _, _, count, degree, bits, _, _ = SPZ_HEADER.unpack_from(raw)
    header = SpzHeader(4, count, degree, bits)
    for name, width in header.sections:
        parts[name] = raw[at : at + count * width]
        at += count * width
    return header, parts


def spz4_bytes(splats: Splats) -> bytes:
    """``splats`` as an SPZ file of version 4."""
    return spz_streams(*spz_parts(splats))
