"""Small splats and files of them, built in code."""

from __future__ import annotations

import gzip
import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cags_common.splats import SH_REST_OF_DEGREE, Splats

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
