"""The web client decodes recorded bundles and chunks of motion to the bits they were written down with."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np

from cags_common.coding.packing import decode_ids, encode_ids, gunzip_bounded, gzip_bytes, squeeze, unsqueeze
from cags_common.errors import DecodeError
from cags_common.tiles.svq import CodebookSet
from support.mutation import mutate
from support.node import run_tests
from vectors.motion import make as motion_vectors

VECTORS = Path(__file__).parents[1] / "vectors"
DAMAGED = 400


def test_tiles_and_updates_of_the_recorded_bundle_at_every_recorded_level(tmp_path: Path) -> None:
    bundle = json.loads((VECTORS / "bundle" / "v9.json").read_text())
    base = CodebookSet.from_bytes(base64.b64decode(bundle["codebooks"])).base.to_bytes()
    bundle["base_codebooks"] = _text(base)
    run_tests("decode", tmp_path, bundle=bundle, chunks=_chunks(), bytes=_bytes())


def _chunks() -> list[dict[str, Any]]:
    """Payloads of recorded chunks, what they are told by, and the arrays that they decode to at each level."""
    with np.load(VECTORS / "motion" / "v11.npz") as file:
        arrays = {key: file[key] for key in file.files}
    out = []
    for name in sorted({key.split("/")[0] for key in arrays}):
        mine = {key.split("/")[1]: array for key, array in arrays.items() if key.startswith(f"{name}/")}
        payloads = [mine.pop(key).tobytes() for key in sorted(mine) if key.startswith("payload-")]
        wanted = {key: _text(array.tobytes()) for key, array in mine.items() if key[0].isdigit()}
        anchors = motion_vectors.anchors_of(len(mine["logits"]))
        told_by = {"positions": anchors.positions, "moves": anchors.moves, "turns": anchors.turns}
        out.append(
            {
                "name": name,
                "payloads": [_text(p) for p in payloads],
                "anchors": {key: _text(array.tobytes()) for key, array in told_by.items()},
                "arrays": wanted,
            }
        )
    assert any(key.endswith("moves") for item in out for key in item["arrays"])
    return out


def _bytes() -> list[dict[str, Any]]:
    """Compressed data, whole and damaged, and what Python makes of it: nothing where it refuses."""
    rng = np.random.default_rng(4)
    out = []
    for _ in range(DAMAGED):
        plain = rng.integers(0, rng.choice([2, 16, 256]), int(rng.integers(0, 3000))).astype(np.uint8).tobytes()
        kind = rng.choice(["squeeze", "gzip", "ids"])
        if kind == "ids":
            ids = np.unique(rng.integers(0, 5000, int(rng.integers(1, 300)))).astype(np.int32)
            data = encode_ids(ids)
        else:
            data = squeeze(plain) if kind == "squeeze" else gzip_bytes(plain)
        if rng.random() < 0.6:
            data = mutate(data, rng)
        out.append({"kind": str(kind), "data": _text(data), "size": len(plain), **_opened(str(kind), data, len(plain))})
    assert 50 < sum("plain" in item for item in out) < DAMAGED - 50
    return out


def _opened(kind: str, data: bytes, size: int) -> dict[str, str]:
    try:
        if kind == "squeeze":
            return {"plain": _text(unsqueeze(data, size, "it"))}
        if kind == "gzip":
            return {"plain": _text(gunzip_bounded(data, 4000, "it"))}
        return {"plain": _text(decode_ids(data, limit=6000).tobytes())}
    except DecodeError:
        return {}


def _text(data: bytes) -> str:
    return base64.b64encode(data).decode()
